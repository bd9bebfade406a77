"""The measured depth that RGB-D methods read, and its holes."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from mvsam.types import Views


def measured_depth(views: Views) -> Float[Tensor, "batch 1 height width"]:
    """Of view 0, metres, 0 = unknown; ValueError where the views have none."""
    if views.measured_depth is None:
        raise ValueError("this model reads measured depth: set views.measured_depth")
    return views.measured_depth[:, None]


def fill_holes(
    depth: Float[Tensor, "batch 1 height width"],
) -> Float[Tensor, "batch 1 height width"]:
    """Unknown pixels take the mean of the smallest cell that knows any: 2x2, 4x4, 8x8, ..."""
    size = depth.shape[-2:]
    if max(size) == 1:
        return depth
    known = (depth > 0).to(depth.dtype)
    share = F.avg_pool2d(known, 2, ceil_mode=True)
    mean = F.avg_pool2d(depth, 2, ceil_mode=True) / share.where(share > 0, 1)
    return depth.where(depth > 0, F.interpolate(fill_holes(mean), size, mode="nearest"))


def jet(values: Float[Tensor, "batch 1 height width"]) -> Float[Tensor, "batch 3 height width"]:
    """0..1 as the colours of a rainbow, blue to red, RGB in 0..1."""
    peaks = values.new_tensor([3.0, 2.0, 1.0])[:, None, None]
    return torch.clamp(1.5 - (4 * values - peaks).abs(), 0, 1)
