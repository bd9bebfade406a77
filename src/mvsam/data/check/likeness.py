"""How alike two photos look when one is warped to the other over a sweep of planes.

At the right poses a patch finds its likeness along its epipolar line; at wrong ones far less often.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float, Float64
from torch import Tensor

from mvsam.data.transforms import area_resize
from mvsam.geometry.warp import source_from_reference_pixels, warp_to_reference
from mvsam.types import Frame

THUMBNAIL = (80, 60)
"""(width, height), pixels."""
NUM_PLANES = 24
WINDOW = 7
MINIMUM_VARIANCE = 2e-4
"""Of grey values in [0, 1]; flatter patches resemble everything."""

Grey = Float[Tensor, "1 1 height width"]


def grey_thumbnail(frame: Frame) -> Grey:
    """Small grey photo in [0, 1]."""
    return area_resize(frame.image, THUMBNAIL).mean(0)[None, None]


def likeness(
    reference: Grey,
    source: Grey,
    intrinsics: Float64[Tensor, "2 3 3"],
    world_from_cam: Float64[Tensor, "2 4 4"],
    depth_range: tuple[float, float],
) -> float:
    """Mean over textured patches of the reference of the correlation (0..1) with the best match.

    Cameras come reference first. 0 if no patch is seen at any depth.
    """
    linear, offset = source_from_reference_pixels(intrinsics[None], world_from_cam[None], 1)
    height, width = reference.shape[-2:]
    hypotheses = _inverse_spaced_depths(depth_range)[:, None, None].expand(-1, height, width)
    with_mask = torch.cat([source, torch.ones_like(source)], dim=1)
    warped = warp_to_reference(with_mask, linear, offset, hypotheses[None])[0]
    images, masks = warped[0][:, None], warped[1][:, None]
    in_view = _window_mean(masks) > 0.999
    best = torch.where(in_view, _correlation(images, reference), 0.0).amax(0)
    is_textured = _moments(reference)[1][0] > MINIMUM_VARIANCE
    seen = in_view.any(0) & is_textured
    return best[seen].clamp_min(0).mean().item() if seen.any() else 0.0


def _inverse_spaced_depths(depth_range: tuple[float, float]) -> Float[Tensor, " plane"]:
    """Even steps of parallax; nearer than a twentieth of the range is hardly ever photographed."""
    nearest = max(depth_range[0], depth_range[1] / 20)
    return 1 / torch.linspace(1 / depth_range[1], 1 / nearest, NUM_PLANES)


def _correlation(
    images: Float[Tensor, "plane 1 height width"], reference: Grey
) -> Float[Tensor, "plane 1 height width"]:
    """Zero-mean normalised correlation of the windows around each pixel."""
    mean, variance = _moments(images)
    reference_mean, reference_variance = _moments(reference)
    covariance = _window_mean(images * reference) - mean * reference_mean
    return covariance / (variance.clamp_min(1e-5) * reference_variance.clamp_min(1e-5)).sqrt()


def _moments(image: Tensor) -> tuple[Tensor, Tensor]:
    mean = _window_mean(image)
    return mean, _window_mean(image.square()) - mean.square()


def _window_mean(values: Tensor) -> Tensor:
    return F.avg_pool2d(values, WINDOW, stride=1, padding=WINDOW // 2, count_include_pad=False)
