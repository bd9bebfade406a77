"""Sec. 3.1: the geometric pyramid, the SAM encoder, and the bridge that adds one to the other."""
