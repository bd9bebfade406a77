"""A second look at the first sweep: how far to believe it, given what lies around each pixel.

A plane sweep scores every pixel by its own patch. Whether a peak is to be trusted, and what depth
to expect where there is none, shows around it: in the picture, in neighbours that match well, in
whether other views see the place at all. Not in the paper; of our networks `tiny` alone does it.
What it is worth: docs/log.md, 2026-11-29.
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from mvsam.convolution import Conv2d, conv_bn_relu
from mvsam.geometry.camera import invert_intrinsics, pixel_centres, scale_intrinsics
from mvsam.geometry.warp import MINIMUM_Z
from mvsam.mvs.cost_volume import sweep_projections
from mvsam.mvs.prior import log_laplace
from mvsam.types import DepthPrior, Views

_QUANTILES = (0.03, 0.1, 0.25, 0.5, 0.75, 0.9, 0.97)
_LOW, _MEDIAN, _HIGH = 1, 3, 5
_FARTHER = 1.05
"""The factor of depth of which it matters how far it moves a match."""
_MOST_SOURCES = 4
"""More than these count as these: it never saw more."""
_MAPS = len(_QUANTILES) + 1 + 2 + 4 + 2
"""Quantiles (the highest probability in the median's place), median, prior, sources, rays."""

_NEAREST = 0.05
"""Metres; nearer depths count as this one, so that their logarithm stays finite."""
_USUAL_PRECISION, _LEAST_PRECISION, _MOST_PRECISION = 1.5, -3.0, 4.5
"""Logarithms: deviations of a fifth, of twenty times, of a ninetieth of depth."""
_ELSEWHERE = -3.5
"""Logarithm of the density that an expectation leaves to all other depths."""
_LEAST_TRUST, _MOST_TRUST = -3.0, 1.5
"""Logarithms of what the probabilities' logarithm is multiplied by."""
_FIRST_WEIGHT = -3.0
"""Logit: an expectation begins with a weight of a twentieth."""


class ContextNetwork(nn.Module):
    """A 2D U-Net over what the first sweep says; for every pixel a trust and an expectation.

    It sees no planes but quantiles of depth relative to their median, that median, and the highest
    probability of a plane, so that other ranges do, and nearly other spacings. The logarithm of the
    probabilities is multiplied by the trust. To it is added, with a weight, the logarithm of a
    Laplace density of the logarithm of depth around the expected one. It begins by leaving all
    nearly as it is.

    feature_channels: of the coarsest level of the pyramid. semantic_channels: of SAM's features.
    """

    def __init__(
        self,
        feature_channels: int,
        semantic_channels: int,
        widths: tuple[int, int, int, int] = (64, 96, 128, 128),
    ):
        super().__init__()
        fine, half, quarter, eighth = widths
        self.level0 = _twice(_MAPS + feature_channels, fine)
        self.level1 = _twice(fine, half)
        self.level2 = _twice(half + semantic_channels, quarter)
        self.level3 = _twice(quarter, eighth)
        self.up2 = conv_bn_relu(eighth + quarter, quarter)
        self.up1 = conv_bn_relu(quarter + half, half)
        self.up0 = conv_bn_relu(half + fine, fine)
        self.out = Conv2d(fine, 4, 3, padding=1)
        nn.init.zeros_(self.out.weight)
        assert self.out.bias is not None
        self.out.bias.data.copy_(torch.tensor([0.0, 0.0, 0.0, _FIRST_WEIGHT]))

    def forward(
        self,
        scores: Float[Tensor, "batch plane height width"],
        hypotheses: Float[Tensor, "batch plane height width"],
        features: Float[Tensor, "batch channel height width"],
        semantic: Float[Tensor, "batch semantic height width"],
        prior: DepthPrior,
        views: Views,
    ) -> Float[Tensor, "batch plane height width"]:
        """New scores of view 0, before the softmax over evenly spaced planes.

        scores: with the prior in them. features, semantic: of view 0. Height and width must be
        divisible by 8. Gradients reach the scores through the trust in them alone: those of a
        quantile have no bound.
        """
        log_probability = torch.log_softmax(scores.float(), dim=1)
        told = log_probability.detach()
        log_quantiles = quantiles(told.exp(), hypotheses).clamp(min=_NEAREST).log()
        maps = [
            *_of_distribution(told, log_quantiles),
            *_of_prior(prior, log_quantiles),
            *_of_sources(log_quantiles, views),
            *_of_rays(views, scores.shape[-2:]),
        ]
        summary = torch.cat([torch.stack(maps, dim=1), features.float()], dim=1)
        shift, precision, trust, weight = self._unet(summary, semantic).float().unbind(dim=1)
        log_precision = (_USUAL_PRECISION + precision).clamp(_LEAST_PRECISION, _MOST_PRECISION)
        expected = log_expectation(log_quantiles[:, _MEDIAN] + shift, log_precision, hypotheses)
        log_trust = trust.clamp(_LEAST_TRUST, _MOST_TRUST)
        return log_trust.exp()[:, None] * log_probability + weight.sigmoid()[:, None] * expected

    def _unet(
        self,
        summary: Float[Tensor, "batch channel height width"],
        semantic: Float[Tensor, "batch semantic height width"],
    ) -> Float[Tensor, "batch 4 height width"]:
        """SAM's features, whose tokens are coarse, enter at a quarter of the size."""
        level0 = self.level0(summary.contiguous(memory_format=torch.channels_last))
        level1 = self.level1(F.avg_pool2d(level0, 2))
        level2 = F.avg_pool2d(level1, 2)
        at_quarter = F.avg_pool2d(semantic.float(), 4).to(level2.dtype)
        level2 = self.level2(torch.cat([level2, at_quarter], dim=1))
        x = self.level3(F.avg_pool2d(level2, 2))
        x = self.up2(torch.cat([_doubled(x), level2], dim=1))
        x = self.up1(torch.cat([_doubled(x), level1], dim=1))
        x = self.up0(torch.cat([_doubled(x), level0], dim=1))
        return self.out(x)


def log_expectation(
    log_depth: Float[Tensor, "batch height width"],
    log_precision: Float[Tensor, "batch height width"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch plane height width"]:
    """Logarithm of a Laplace density around `log_depth`, one over metres but for a constant."""
    laplace = log_laplace(log_depth, log_precision, hypotheses.clamp(min=_NEAREST).log())
    return torch.logaddexp(laplace, torch.full_like(laplace, _ELSEWHERE))


def quantiles(
    probability: Float[Tensor, "batch plane height width"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch quantile height width"]:
    """Depths below which 3, 10, 25, 50, 75, 90 and 97 % of the probability lie, metres.

    The probability of each plane spreads evenly over the half intervals to both its sides; the
    hypotheses are evenly spaced.
    """
    below = probability.cumsum(dim=1) - probability
    width = probability.clamp(min=1e-6)
    interval = hypotheses[:, 1] - hypotheses[:, 0]
    places = [((share - below) / width).clamp(0, 1).sum(dim=1) - 0.5 for share in _QUANTILES]
    return torch.stack([hypotheses[:, 0] + interval * place for place in places], dim=1)


def _of_distribution(
    log_probability: Float[Tensor, "batch plane height width"],
    log_quantiles: Float[Tensor, "batch quantile height width"],
) -> list[Float[Tensor, "batch height width"]]:
    """Quantiles over the median, the highest probability in the place of its own; the median.

    These maps, as all others, are brought to about -1..1 by factors that were never sought.
    """
    median = log_quantiles[:, _MEDIAN]
    ratios = [4 * (quantile - median) for quantile in log_quantiles.unbind(dim=1)]
    highest = 4 * log_probability.amax(dim=1).exp()
    return [*ratios[:_MEDIAN], highest, *ratios[_MEDIAN + 1 :], 2 * (median - 0.7)]


def _of_prior(
    prior: DepthPrior, log_quantiles: Float[Tensor, "batch quantile height width"]
) -> list[Float[Tensor, "batch height width"]]:
    """How far it lies from the median, and how precise it is."""
    return [2 * (prior.log_median - log_quantiles[:, _MEDIAN]), prior.log_precision - 1]


@torch.no_grad()
def _of_sources(
    log_quantiles: Float[Tensor, "batch quantile height width"], views: Views
) -> list[Float[Tensor, "batch height width"]]:
    """How many see the place if it is near, at the median, or far, and how well they can tell.

    The last: how many cells a match moves in the best of those that see the median, where depth
    grows from there by a twentieth; its logarithm.
    """
    depths = log_quantiles[:, _LOW : _HIGH + 1 : _MEDIAN - _LOW].exp()
    depths = torch.cat([depths, depths[:, 1:2] * _FARTHER], dim=1)
    places, is_seen = _in_sources(depths, views)
    moved = (places[:, :, 3] - places[:, :, 1]).norm(dim=-1).clamp(max=20.0)
    best = (moved * is_seen[:, :, 1]).amax(dim=1)
    counts = is_seen[:, :, :3].float().sum(dim=1).clamp(max=_MOST_SOURCES) / 2
    return [*counts.unbind(dim=1), (best + 0.05).log() / 2 + 0.5]


def _in_sources(
    depths: Float[Tensor, "batch depth height width"], views: Views
) -> tuple[
    Float[Tensor, "batch source depth height width 2"],
    Bool[Tensor, "batch source depth height width"],
]:
    """Where depths of view 0 lie in every source, in cells, and whether they lie inside it."""
    height, width = depths.shape[-2:]
    intrinsics = scale_intrinsics(views.intrinsics, width / views.width, height / views.height)
    projections = sweep_projections(intrinsics, views.world_from_cam)[:, 1:]
    linear, offset = projections[..., :9].unflatten(-1, (3, 3)), projections[..., 9:].to(depths)
    rays = _carried(linear, height, width).to(depths)
    points = rays[:, :, None] * depths[:, None, ..., None] + offset[:, :, None, None, None]
    z = points[..., 2:]
    places = points[..., :2] / torch.where(z > MINIMUM_Z, z, torch.ones_like(z))
    size = places.new_tensor([width, height])
    is_inside = ((places >= 0) & (places < size)).all(dim=-1)
    return places, is_inside & (z[..., 0] > MINIMUM_Z)


def _of_rays(views: Views, size: Sequence[int]) -> list[Float[Tensor, "batch height width"]]:
    """Slopes of the line of sight of every cell."""
    height, width = size
    intrinsics = scale_intrinsics(
        views.intrinsics[:, :1], width / views.width, height / views.height
    )
    rays = _carried(invert_intrinsics(intrinsics), height, width)[:, 0].float()
    return [rays[..., 0], rays[..., 1]]


def _carried(
    linear: Float[Tensor, "batch view 3 3"], height: int, width: int
) -> Float[Tensor, "batch view height width 3"]:
    """Cells carried by a matrix, in float64, which autocast leaves alone."""
    pixels = pixel_centres(height, width, device=linear.device, dtype=torch.float64)
    return torch.einsum("bvij,hwj->bvhwi", linear.double(), pixels)


def _twice(in_channels: int, out_channels: int) -> nn.Sequential:
    return nn.Sequential(
        conv_bn_relu(in_channels, out_channels), conv_bn_relu(out_channels, out_channels)
    )


def _doubled(x: Float[Tensor, "batch channel _height _width"]) -> Tensor:
    return F.interpolate(x, scale_factor=2, mode="nearest")
