"""Depth hypotheses: evenly spaced planes first, then windows around the coarser depth."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def base_interval(
    depth_range: Float[Tensor, "batch 2"], num_bins: int = 192
) -> Float[Tensor, " batch"]:
    """Width of one of the paper's 192 virtual bins, metres: 4.9 / 192 = 2.5521 cm by default.

    The paper says "roughly 2.5 cm". Dividing by the count, not by count - 1, makes 48 planes of
    four bins span the range exactly.
    """
    return (depth_range[:, 1] - depth_range[:, 0]) / num_bins


def plane_depths(
    depth_range: Float[Tensor, "batch 2"], num_planes: int
) -> Float[Tensor, "batch plane"]:
    """Evenly spaced depth hypotheses for the coarsest stage, metres (Sec. 3.2).

    The first and last plane lie exactly on d_min and d_max. The paper does not say whether the
    ends are included; including them gives 10.43 cm for 48 planes over [0.1, 5.0] m.
    """
    steps = torch.linspace(0, 1, num_planes, device=depth_range.device, dtype=depth_range.dtype)
    near, far = depth_range[:, :1], depth_range[:, 1:]
    return torch.lerp(near, far, steps)


def window_hypotheses(
    centre: Float[Tensor, "batch height width"],
    half_width: Float[Tensor, " batch"],
    num_planes: int,
    nearest: Float[Tensor, " batch"] | None,
) -> Float[Tensor, "batch plane height width"]:
    """`num_planes` depths over centre +- half_width, ends included, metres.

    nearest: windows that would begin before this depth are shifted to begin there (near surfaces
    would otherwise get negative depths); None leaves them, as CasMVSNet does.
    """
    begin = centre - half_width[:, None, None]
    if nearest is not None:
        begin = torch.maximum(begin, nearest[:, None, None])
    steps = torch.linspace(0, 2, num_planes, device=centre.device, dtype=centre.dtype)
    return begin[:, None] + half_width[:, None, None, None] * steps[:, None, None]


def resample_depth(
    depth: Float[Tensor, "batch coarse_height coarse_width"],
    full_size: tuple[int, int],
    size: tuple[int, int],
) -> Float[Tensor, "batch height width"]:
    """The coarser depth at this stage's size, by way of the full image size as in CasMVSNet."""
    depth = depth[:, None]
    depth = F.interpolate(depth, full_size, mode="bilinear", align_corners=False)
    if size != full_size:
        depth = F.interpolate(depth, size, mode="bilinear", align_corners=False)
    return depth[:, 0]
