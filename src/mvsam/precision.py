"""bfloat16 where the hardware multiplies it natively; float32 elsewhere."""

from contextlib import AbstractContextManager
from typing import Literal

import torch

Precision = Literal["auto", "float32", "bfloat16"]
"""auto: bfloat16 where the processor or the GPU has it."""


def has_native_bfloat16(device: str) -> bool:
    """Whether `device` ("cpu" or "cuda") has instructions for bfloat16 products.

    On CPUs without them a bfloat16 model is slower than a float32 one.
    """
    if device == "cuda":
        return torch.cuda.is_available() and torch.cuda.is_bf16_supported(including_emulation=False)
    return torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()


def resolve(precision: Precision, device: str) -> Literal["float32", "bfloat16"]:
    """What the name means on `device`."""
    if precision == "auto":
        return "bfloat16" if has_native_bfloat16(device) else "float32"
    return precision


def autocast(device: str, precision: Precision = "auto") -> AbstractContextManager:
    """Runs a model in this precision; weights, geometry and softmax stay in float32."""
    return torch.autocast(device, torch.bfloat16, enabled=resolve(precision, device) == "bfloat16")
