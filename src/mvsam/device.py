"""Where models run."""

from typing import Literal

import torch
from torch import nn

from mvsam.errors import InputError


def find_device(wanted: str, option: str = "--device") -> Literal["cpu", "cuda"]:
    """Where to run: on the processor, or on a GPU where "auto" finds one or it is asked for.

    Raises InputError where a GPU is asked for ("cuda", "gpu") and there is none.
    """
    has_gpu = torch.cuda.is_available()
    if wanted in ("cuda", "gpu") and not has_gpu:
        raise InputError(f"no CUDA device was found: leave {option} out to use the processor.")
    return "cuda" if has_gpu and wanted != "cpu" else "cpu"


def device_of(model: nn.Module) -> torch.device:
    """Where its parameters are."""
    return next((parameter.device for parameter in model.parameters()), torch.device("cpu"))
