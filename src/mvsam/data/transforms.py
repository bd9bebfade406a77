"""Resizing and cropping photos, maps and intrinsics together, in the corner convention."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Int, Shaped, UInt8
from torch import Tensor

from mvsam.types import Frame

Size = tuple[int, int]
"""(width, height), pixels."""


def area_resize(
    image: UInt8[np.ndarray, "height width 3"], size: Size
) -> Float[Tensor, "3 new_height new_width"]:
    """RGB in [0, 1]: area average along an axis that shrinks, bilinear along one that grows."""
    height, width = image.shape[:2]
    values = torch.tensor(image, dtype=torch.float32)
    if size[1] < height:
        values = torch.einsum("rh,hwc->rwc", area_weights(height, size[1]), values)
    if size[0] < width:
        values = torch.einsum("kw,rwc->rkc", area_weights(width, size[0]), values)
    resized = values.permute(2, 0, 1).contiguous() / 255
    if resized.shape[-2:] != (size[1], size[0]):
        resized = F.interpolate(
            resized[None], (size[1], size[0]), mode="bilinear", align_corners=False
        )[0]
    return resized


@lru_cache(maxsize=32)
def area_weights(old: int, new: int) -> Float[Tensor, "new old"]:
    """Share of each old pixel in each new one; rows sum to 1.

    (Pillow's box filter takes whole pixels only, which shifts content by up to half a pixel.)
    """
    edges = torch.arange(new + 1, dtype=torch.float64) * (old / new)
    pixels = torch.arange(old, dtype=torch.float64)
    last = torch.minimum(edges[1:, None], pixels + 1)
    first = torch.maximum(edges[:-1, None], pixels)
    covered = (last - first).clamp_min(0)
    return (covered / covered.sum(1, keepdim=True)).float()


def resize_nearest(
    values: Shaped[np.ndarray, "height width"], size: Size
) -> Shaped[np.ndarray, "new_height new_width"]:
    """Depth or labels read at the old pixel that holds each new pixel's centre.

    A centre on the border of two takes the right or lower one.
    """
    height, width = values.shape
    columns, rows = _nearest_indices(width, size[0]), _nearest_indices(height, size[1])
    return values[rows[:, None], columns]


def _nearest_indices(old: int, new: int) -> Int[np.ndarray, " new"]:
    """floor((i + 0.5) * old / new), in integers so that no rounding moves a pixel."""
    return (2 * np.arange(new) + 1) * old // (2 * new)


def resize_intrinsics(
    intrinsics: Float[np.ndarray, "3 3"], old: Size, new: Size
) -> Float[np.ndarray, "3 3"]:
    """Intrinsics of the resized picture; with corners at 0 no half pixel enters."""
    return intrinsics * np.array([[new[0] / old[0]], [new[1] / old[1]], [1.0]])


def crop_to_shape(frame: Frame, size: Size) -> Frame:
    """The largest central part of a frame that has the shape (width : height) of `size`.

    Nothing is resized, so that the part is exact to the pixel.
    """
    width, height = frame.size
    new_width = min(width, round(height * size[0] / size[1]))
    new_height = min(height, round(width * size[1] / size[0]))
    corner = (width - new_width) // 2, (height - new_height) // 2
    return crop_to_window(frame, corner, (new_width, new_height))


def crop_to_window(frame: Frame, corner: tuple[int, int], size: Size) -> Frame:
    """The part of a frame that begins at `corner` (left, top) and is `size` large, pixels."""
    (left, top), (width, height) = corner, size
    rows, columns = slice(top, top + height), slice(left, left + width)

    def part(load: Callable[[], np.ndarray]) -> Callable[[], np.ndarray]:
        return lambda: load()[rows, columns]

    return replace(
        frame,
        size=size,
        intrinsics=frame.intrinsics - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]]),
        load_image=part(frame.load_image),
        load_depth=part(frame.load_depth) if frame.load_depth else None,
        load_labels=part(frame.load_labels) if frame.load_labels else None,
    )
