"""The bridge of Figure 3: SAM features shaped into the geometric pyramid and added to it."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from mvsam.convolution import conv_bn_relu


class SemanticPyramid(nn.Module):
    """A light convolutional pyramid over SAM features (Sec. 3.1, "lightweight").

    The paper does not give its layers. One 3x3 block and one linear convolution a level keep it
    light and end each level as the geometric pyramid ends, so that both summands of the point-wise
    sum are linear maps of equal width.
    """

    def __init__(
        self, in_channels: int, out_channels: tuple[int, int, int] = (32, 16, 8), width: int = 32
    ):
        super().__init__()
        self.at_quarter = conv_bn_relu(in_channels, width)
        self.at_half = conv_bn_relu(width, width)
        self.at_full = conv_bn_relu(width, width)
        self.out_quarter = nn.Conv2d(width, out_channels[0], 1, bias=False)
        self.out_half = nn.Conv2d(width, out_channels[1], 3, padding=1, bias=False)
        self.out_full = nn.Conv2d(width, out_channels[2], 3, padding=1, bias=False)

    def forward(
        self, features: Float[Tensor, "images channel h1 w1"]
    ) -> tuple[
        Float[Tensor, "images c1 h1 w1"],
        Float[Tensor, "images c2 h2 w2"],
        Float[Tensor, "images c3 height width"],
    ]:
        """Coarse to fine, at 1, 2 and 4 times the size of the given features."""
        quarter = self.at_quarter(features)
        half = self.at_half(_twice(quarter))
        full = self.at_full(_twice(half))
        return self.out_quarter(quarter), self.out_half(half), self.out_full(full)


def _twice(features: Tensor) -> Tensor:
    return F.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)
