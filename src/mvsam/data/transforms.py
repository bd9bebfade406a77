"""Resizing photos, maps and intrinsics together, in the corner convention."""

import numpy as np
import torch
from jaxtyping import Float, Shaped, UInt8
from PIL import Image
from torch import Tensor

Size = tuple[int, int]
"""(width, height), pixels."""


def area_resize(
    image: UInt8[np.ndarray, "height width 3"], size: Size
) -> Float[Tensor, "3 new_height new_width"]:
    """RGB in [0, 1]: area average along an axis that shrinks, bilinear along one that grows."""
    picture = Image.fromarray(image)
    shrunk = (min(size[0], picture.width), min(size[1], picture.height))
    picture = picture.resize(shrunk, Image.Resampling.BOX).resize(size, Image.Resampling.BILINEAR)
    return torch.from_numpy(np.array(picture)).permute(2, 0, 1).contiguous().float() / 255


def resize_nearest(
    values: Shaped[np.ndarray, "height width"], size: Size
) -> Shaped[np.ndarray, "new_height new_width"]:
    """Depth or labels read at the source pixel that holds each new pixel's centre."""
    height, width = values.shape
    columns, rows = _nearest_indices(width, size[0]), _nearest_indices(height, size[1])
    return values[rows[:, None], columns]


def _nearest_indices(old: int, new: int) -> Shaped[np.ndarray, " new"]:
    """floor((i + 0.5) * old / new), in integers so that no rounding moves a pixel."""
    return (2 * np.arange(new) + 1) * old // (2 * new)


def resize_intrinsics(
    intrinsics: Float[np.ndarray, "3 3"], old: Size, new: Size
) -> Float[np.ndarray, "3 3"]:
    """Intrinsics of the resized picture; with corners at 0 no half pixel enters."""
    return intrinsics * np.array([[new[0] / old[0]], [new[1] / old[1]], [1.0]])
