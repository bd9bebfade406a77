"""The geometry-aware encoder of Figure 3: CasMVSNet's feature pyramid at three scales."""

from collections.abc import Sequence
from typing import Literal

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from mvsam.convolution import Conv2d, add, conv_bn_relu


class FeaturePyramid(nn.Module):
    """Features at 1/4, 1/2 and 1/1 of the image, `4 * base`, `2 * base` and `base` wide (Sec. 3.1).

    The paper follows CasMVSNet and leaves the widths open; `base` = 8 is CasMVSNet's.
    heads: what ends each level, coarse to fine, given 4 * base channels; None: one linear
    convolution, as CasMVSNet has it.
    upsampling: of what a coarser level gives to a finer one. CasMVSNet takes the nearest, which
    makes blocks of four pixels that the finest sweep matches for their borders (docs/log.md).
    """

    def __init__(
        self,
        base: int = 8,
        heads: Sequence[nn.Module] | None = None,
        upsampling: Literal["nearest", "bilinear"] = "nearest",
    ):
        super().__init__()
        self.upsampling = upsampling
        self.channels = (4 * base, 2 * base, base)
        wide, middle, narrow = self.channels
        self.at_full = nn.Sequential(conv_bn_relu(3, narrow), conv_bn_relu(narrow, narrow))
        self.at_half = nn.Sequential(
            conv_bn_relu(narrow, middle, kernel_size=5, stride=2),
            conv_bn_relu(middle, middle),
            conv_bn_relu(middle, middle),
        )
        self.at_quarter = nn.Sequential(
            conv_bn_relu(middle, wide, kernel_size=5, stride=2),
            conv_bn_relu(wide, wide),
            conv_bn_relu(wide, wide),
        )
        self.lateral_half = Conv2d(middle, wide, 1)
        self.lateral_full = Conv2d(narrow, wide, 1)
        self.out_quarter, self.out_half, self.out_full = heads or (
            Conv2d(wide, wide, 1, bias=False),
            Conv2d(wide, middle, 3, padding=1, bias=False),
            Conv2d(wide, narrow, 3, padding=1, bias=False),
        )

    def extra_repr(self) -> str:
        return f"upsampling={self.upsampling}"

    def forward(
        self, images: Float[Tensor, "images 3 height width"]
    ) -> tuple[
        Float[Tensor, "images c1 h1 w1"],
        Float[Tensor, "images c2 h2 w2"],
        Float[Tensor, "images c3 height width"],
    ]:
        """Coarse to fine. RGB in [0, 1] without mean or deviation, as CasMVSNet takes it."""
        full = self.at_full(images)
        half = self.at_half(full)
        top = self.at_quarter(half)
        coarse = self.out_quarter(top)
        top = add(F.interpolate(top, scale_factor=2, mode=self.upsampling), self.lateral_half(half))
        middle = self.out_half(top)
        top = add(F.interpolate(top, scale_factor=2, mode=self.upsampling), self.lateral_full(full))
        return coarse, middle, self.out_full(top)
