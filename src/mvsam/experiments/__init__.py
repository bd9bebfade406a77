"""Runs as Python values: everything needed to repeat one, and the driver that trains it."""
