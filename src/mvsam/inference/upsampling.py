"""From the network's size to the photo's: one rule for each kind of map.

All three sample with the image covering [0, W] x [0, H] at both sizes.
"""

import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor
from torch.nn.functional import interpolate

LARGEST_JUMP = 0.05
"""Depths that differ by more than this fraction belong to different surfaces."""


def depth_at_size(
    depth: Float[Tensor, "height width"], size: tuple[int, int]
) -> Float[Tensor, "photo_height photo_width"]:
    """Depth at (width, height): bilinear within a surface, nearest across an edge.

    Blending across an edge would hang points in the air between a chair and the wall behind it.
    An edge is where the four blended depths differ by more than `LARGEST_JUMP`, or one is unknown.
    """
    if size == (depth.shape[1], depth.shape[0]):
        return depth
    corners = torch.stack(_four_neighbours(depth, size))
    nearest_of_four, farthest_of_four = corners.amin(dim=0), corners.amax(dim=0)
    is_smooth = farthest_of_four <= (1 + LARGEST_JUMP) * nearest_of_four
    return torch.where(
        is_smooth, smooth_at_size(depth, size), _resize(depth, size, "nearest-exact")
    )


def smooth_at_size(
    values: Float[Tensor, "height width"], size: tuple[int, int]
) -> Float[Tensor, "photo_height photo_width"]:
    """Bilinear at (width, height)."""
    return _resize(values, size, "bilinear")


def labels_at_size(
    logits: Float[Tensor, "num_classes height width"], size: tuple[int, int]
) -> UInt8[Tensor, "photo_height photo_width"]:
    """The most likely class at (width, height), from bilinear logits.

    Class by class, so that a 12-megapixel photo needs three maps of memory, not twenty.
    """
    best = smooth_at_size(logits[0], size)
    labels = torch.zeros_like(best, dtype=torch.uint8)
    for label in range(1, len(logits)):
        score = smooth_at_size(logits[label], size)
        labels[score > best] = label
        best = torch.maximum(best, score)
    return labels


def _resize(
    values: Float[Tensor, "height width"], size: tuple[int, int], mode: str
) -> Float[Tensor, "photo_height photo_width"]:
    if size == (values.shape[1], values.shape[0]):
        return values
    align_corners = False if mode == "bilinear" else None
    width, height = size
    return interpolate(
        values[None, None], size=(height, width), mode=mode, align_corners=align_corners
    )[0, 0]


def _four_neighbours(
    values: Float[Tensor, "height width"], size: tuple[int, int]
) -> list[Float[Tensor, "photo_height photo_width"]]:
    """The four values that bilinear sampling blends at each pixel of (width, height)."""
    width, height = size
    rows = _two_neighbours(values.shape[0], height, values.device)
    columns = _two_neighbours(values.shape[1], width, values.device)
    return [values[row][:, column] for row in rows for column in columns]


def _two_neighbours(
    num_from: int, num_to: int, device: torch.device
) -> tuple[Int[Tensor, "sample"], Int[Tensor, "sample"]]:
    """Indices of the samples before and after each new sample's position."""
    position = (torch.arange(num_to, device=device) + 0.5) * (num_from / num_to) - 0.5
    before = position.floor().long()
    return before.clamp(min=0), (before + 1).clamp(max=num_from - 1)
