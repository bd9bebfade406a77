"""Depth maps as files keep them: whole millimetres in 16 bits, 0 = unknown."""

import numpy as np
from jaxtyping import Float, Float32, UInt16

MILLIMETRES = np.float32(1000)
"""In a metre."""


def to_millimetres(depth: Float[np.ndarray, "*pixels"]) -> UInt16[np.ndarray, "*pixels"]:
    """The nearest whole millimetre of metres; all beyond 65.535 m become that."""
    return np.clip(np.rint(depth * MILLIMETRES), 0, 65535).astype(np.uint16)


def from_millimetres(
    pixels: np.ndarray,
) -> Float32[np.ndarray, "height width"]:
    """Metres; `pixels` may have any type a picture is decoded to."""
    return pixels.astype(np.float32) / MILLIMETRES
