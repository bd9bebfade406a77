"""Shapes in signatures are checked at run time here and nowhere else; torch takes one thread."""

import logging
import os

from jaxtyping import install_import_hook

install_import_hook("mvsam", "beartype.beartype")

import torch  # noqa: E402  (the hook comes before anything that may import mvsam)

torch.set_num_threads(1)
logging.getLogger("mvsam").setLevel(logging.INFO)  # as the command line does
if not torch.cuda.is_available():
    os.environ["TRITON_INTERPRET"] = "1"  # read when triton is imported: its kernels run on the CPU
