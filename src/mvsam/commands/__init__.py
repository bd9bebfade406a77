"""One file a verb of `mvsam`: a dataclass whose docstrings are its --help, and what it does.

Only light modules are imported above the functions, so that `mvsam --help` answers at once.
"""
