"""SSMA (Valada et al., IJCV 2020): two AdapNet++ encoders, 56,200,892 parameters for 20 classes.

One sees the picture, the other the measured depth in colours; at each of three scales a gate says
what of both goes on to the one decoder.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from mvsam.baselines.adapnet_pp import (
    SKIP_WIDTH,
    WIDTH,
    Decoder,
    Encoder,
    batch_norm,
    conv_block,
    initialize,
)
from mvsam.baselines.imagenet import reference_image
from mvsam.baselines.measured import fill_holes, jet, measured_depth
from mvsam.types import Model, Prediction, Views


class Ssma(Model):
    """Semantics of view 0 from its picture and measured depth; trained by `AdapNetPPLoss`.

    The publication trains each encoder first as an AdapNet++ of its own and keeps it frozen
    (`encoders`) before all learn together; two pictures or more at a time. Its depth is filled by
    another method. `Prediction.auxiliary` and its parameters are those of `AdapNetPP`.
    """

    reads_depth = True

    def __init__(self, num_classes: int = 20):
        super().__init__()
        self.num_classes = num_classes
        self.encoders = nn.ModuleDict({"color": Encoder(), "depth": Encoder()})
        mix = nn.Sequential(nn.Conv2d(2 * WIDTH, WIDTH, 1, bias=False), batch_norm(WIDTH))
        self.fusion = nn.ModuleList(
            [GatedFusion(WIDTH, 32, mix), _skip_fusion(), _skip_fusion()],
        )
        self.decoder = Decoder(num_classes, [GatedConcatenation(), GatedConcatenation()])
        initialize(self)

    def forward(self, views: Views) -> Prediction:
        """Logits at the picture's size; sides must be divisible by 16."""
        color = self.encoders["color"](reference_image(views, divisor=16))
        depth = self.encoders["depth"](depth_in_colors(views))
        scales = zip(self.fusion, color, depth, strict=True)
        features, coarser, finer = (fuse(*pair) for fuse, *pair in scales)
        return self.decoder((features, coarser, finer))


def depth_in_colors(views: Views) -> Float[Tensor, "batch 3 height width"]:
    """Measured depth without holes, blue at d_min to red at d_max.

    The sources do not say which depths the colours span.
    """
    near, far = views.depth_range.T[:, :, None, None, None]
    depth = fill_holes(measured_depth(views))
    return jet(((depth - near) / (far - near)).clamp(0, 1))


class GatedFusion(nn.Module):
    """Two inputs of equal width, each value times a gate in 0..1 that sees both, then mixed."""

    def __init__(self, channels: int, narrow: int, mix: nn.Module):
        super().__init__()
        self.gate = nn.Sequential(
            nn.Conv2d(2 * channels, narrow, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(narrow, 2 * channels, 3, padding=1),
            nn.Sigmoid(),
        )
        self.mix = mix

    def forward(
        self,
        color: Float[Tensor, "batch channel height width"],
        depth: Float[Tensor, "batch channel height width"],
    ) -> Float[Tensor, "batch _mixed height width"]:
        both = torch.cat([color, depth], dim=1)
        return self.mix(self.gate(both) * both)


class GatedConcatenation(nn.Module):
    """How SSMA's decoder takes a skip in: weighted, a channel, by the mean of what it has."""

    def __init__(self):
        super().__init__()
        self.gate = nn.Sequential(nn.AdaptiveAvgPool2d(1), *conv_block(WIDTH, SKIP_WIDTH))

    def forward(
        self,
        x: Float[Tensor, "batch channel height width"],
        skip: Float[Tensor, "batch skip_channel height width"],
    ) -> Float[Tensor, "batch joined height width"]:
        return torch.cat([x, self.gate(x) * skip], dim=1)


def _skip_fusion() -> GatedFusion:
    return GatedFusion(SKIP_WIDTH, 8, nn.Conv2d(2 * SKIP_WIDTH, SKIP_WIDTH, 3, padding=1))
