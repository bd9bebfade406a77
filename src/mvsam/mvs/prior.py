"""What one picture alone says about depth: a prior on the hypotheses of the first sweep.

Where surfaces are plain, or no other view sees them, a plane sweep says nothing: all hypotheses
match alike. Not in the paper; `tiny_prior` has it.
"""

from jaxtyping import Float
from torch import Tensor, nn

from mvsam.encoders.fpn import conv_bn_relu
from mvsam.types import DepthPrior, Views

_MEDIAN, _PRECISION = 0.9, -2.0
"""What it begins with everywhere: the logarithms of 2.5 m, and of a precision that decides nothing
(a hypothesis twice as deep scores a tenth less)."""
_MOST_PRECISE = 4.0
"""Logarithm: the median is a fiftieth off."""


class MonocularPrior(nn.Module):
    """Median and precision of the logarithm of depth, from the semantic features of the reference.

    A thing looks as large at twice the distance through a lens of twice the focal length; so the
    network says how deep it were if the focal length filled the picture, and the camera the rest.
    """

    def __init__(self, in_channels: int, width: int = 64):
        super().__init__()
        self.layers = nn.Sequential(
            conv_bn_relu(in_channels, width), conv_bn_relu(width, width), nn.Conv2d(width, 2, 1)
        )
        last = self.layers[-1]
        assert isinstance(last, nn.Conv2d) and last.bias is not None
        nn.init.normal_(last.weight, std=0.01)
        last.bias.data.copy_(last.bias.new_tensor([_MEDIAN, _PRECISION]))

    def forward(self, features: Float[Tensor, "batch channel h4 w4"], views: Views) -> DepthPrior:
        """Of view 0, whose features these are."""
        median, precision = self.layers(features).float().unbind(dim=1)
        intrinsics = views.intrinsics[:, 0]
        focal_x, focal_y = intrinsics[:, 0, 0] / views.width, intrinsics[:, 1, 1] / views.height
        lens = (focal_x * focal_y).log() / 2
        return DepthPrior(median + lens[:, None, None], precision.clamp(max=_MOST_PRECISE).exp())


def log_density(
    prior: DepthPrior, hypotheses: Float[Tensor, "batch plane h4 w4"]
) -> Float[Tensor, "batch plane h4 w4"]:
    """Of each hypothesis but for a constant; added to the sweep's scores it weighs them.

    Laplace's distribution of the logarithm of depth, so that a sweep that is sure of a depth far
    from the median overrules it.
    """
    off = hypotheses.clamp(min=1e-3).log() - prior.log_depth[:, None]
    return -prior.precision[:, None] * off.abs()
