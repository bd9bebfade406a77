"""Shapes in signatures are checked at run time here and nowhere else."""

from jaxtyping import install_import_hook

install_import_hook("mvsam", "beartype.beartype")
