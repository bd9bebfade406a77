"""What one picture alone says about depth: a prior on the hypotheses of the first sweep.

Where surfaces are plain, or no other view sees them, a plane sweep says nothing: all hypotheses
match alike. Not in the paper; of our networks `tiny` alone has it.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from mvsam.convolution import Conv2d, conv_bn_relu
from mvsam.types import DepthPrior, Views

_LOG_MEDIAN, _LOG_PRECISION = 0.9, -2.0
"""What it begins with everywhere: 2.5 m through a lens as long as the picture is wide, and next to
no precision."""
_MOST_PRECISE = 4.0
"""Logarithm of the precision: deviations of a fiftieth."""
_OUTLIERS = 0.05
"""How often the picture misleads: that share of the prior lies evenly over all hypotheses, so that
a sweep that is sure of another depth overrules it, however precise it is."""


class MonocularPrior(nn.Module):
    """Median and precision of the logarithm of depth, from SAM's features of the reference.

    A thing twice as far away looks the same through a lens twice as long. So the layers give depth
    divided by the focal length, that as a share of the picture's sides (their geometric mean).
    """

    def __init__(self, in_channels: int, width: int = 64):
        super().__init__()
        last = Conv2d(width, 2, 1)
        nn.init.normal_(last.weight, std=0.01)
        assert last.bias is not None
        last.bias.data.copy_(last.bias.new_tensor([_LOG_MEDIAN, _LOG_PRECISION]))
        self.layers = nn.Sequential(
            conv_bn_relu(in_channels, width), conv_bn_relu(width, width), last
        )

    def forward(self, features: Float[Tensor, "batch channel h4 w4"], views: Views) -> DepthPrior:
        """The prior of view 0, whose features these are."""
        median, precision = self.layers(features).float().unbind(dim=1)
        intrinsics = views.intrinsics[:, 0]
        focal_x, focal_y = intrinsics[:, 0, 0] / views.width, intrinsics[:, 1, 1] / views.height
        lens = (focal_x * focal_y).log() / 2
        bounded = _MOST_PRECISE - F.softplus(_MOST_PRECISE - precision)
        return DepthPrior(median + lens[:, None, None], bounded)


def log_laplace(
    log_median: Float[Tensor, "batch h4 w4"],
    log_precision: Float[Tensor, "batch h4 w4"],
    log_depth: Float[Tensor, "batch plane h4 w4"],
) -> Float[Tensor, "batch plane h4 w4"]:
    """Logarithm of twice Laplace's density of the logarithm of depth, taken over metres."""
    off = (log_depth - log_median[:, None]).abs()
    return log_precision[:, None] - off * log_precision.exp()[:, None] - log_depth


def log_density(
    prior: DepthPrior, hypotheses: Float[Tensor, "batch plane h4 w4"]
) -> Float[Tensor, "batch plane h4 w4"]:
    """Logarithm of the prior's density at each hypothesis, one over metres.

    The hypotheses span the depth range evenly. Added to the sweep's scores it weighs them.
    """
    log_depth = hypotheses.clamp(min=1e-3).log()
    laplace = log_laplace(prior.log_median, prior.log_precision, log_depth) - math.log(2)
    evenly = -(hypotheses[:, -1:] - hypotheses[:, :1]).clamp(min=1e-3).log()
    return torch.logaddexp(
        laplace + math.log(1 - _OUTLIERS), (evenly + math.log(_OUTLIERS)).expand_as(laplace)
    )
