"""Sec. 3.2: hypotheses, cost volumes, their regularisation, and the cascade over three scales."""
