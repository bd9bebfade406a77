"""Losses (Eq. 4), the paper's optimiser, and the Lightning module that joins them."""
