"""Shapes in signatures are checked at run time here and nowhere else; torch takes one thread."""

from jaxtyping import install_import_hook

install_import_hook("mvsam", "beartype.beartype")

import torch  # noqa: E402  (the hook comes before anything that may import mvsam)

torch.set_num_threads(1)
