"""Parametric furniture: every function throws dice and returns one thing in its own axes."""
