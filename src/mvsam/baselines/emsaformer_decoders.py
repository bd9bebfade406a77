"""EMSAFormer's two decoders, from the context at 1/32 and skips at 1/4, 1/8, 1/16 to logits."""

from collections.abc import Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from mvsam.types import Prediction

CONTEXT_CHANNELS = 1024
SKIP_CHANNELS = (128, 256, 512)
"""Finest first, as the encoder gives the skips: channels last, before their layer norm."""

Skips = Sequence[Float[Tensor, "batch _height _width _channel"]]
Context = Float[Tensor, "batch 1024 _rows _columns"]


class EmsaNetDecoder(nn.Module):
    """EMSANet's: 18,649,568 parameters for 20 classes, those of its side outputs among them.

    `Prediction.auxiliary` holds the side outputs at 1/32, 1/16 and 1/8.
    """

    def __init__(self, num_classes: int):
        super().__init__()
        widths = SKIP_CHANNELS[::-1]
        self.refine = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(in_channels, channels, 3, padding=1, bias=False),
                nn.BatchNorm2d(channels),
                nn.ReLU(),
                *(FactoredBlock(channels) for _ in range(3)),
            )
            for in_channels, channels in pairwise((CONTEXT_CHANNELS, *widths))
        )
        self.side_heads = nn.ModuleList(nn.Conv2d(width, num_classes, 1) for width in widths)
        self.enlarge = nn.ModuleList(Enlargement(width) for width in widths)
        self.skip_norms = nn.ModuleList(nn.LayerNorm(width) for width in widths)
        self.head = _head(num_classes)

    def forward(self, context: Context, skips: Skips) -> Prediction:
        x, sides = context, []
        layers = zip(self.refine, self.side_heads, self.enlarge, self.skip_norms, strict=True)
        for skip, (refine, side_head, enlarge, norm) in zip(reversed(skips), layers, strict=True):
            x = refine(x)
            sides.append(Prediction(logits=side_head(x).float()))
            x = enlarge(x) + norm(skip).movedim(-1, 1)
        return Prediction(logits=self.head(x).float(), auxiliary=tuple(sides))


class MlpDecoder(nn.Module):
    """SegFormer's: each scale embedded by itself, all mixed at 1/4; 443,812 parameters."""

    def __init__(self, num_classes: int):
        super().__init__()
        widths = ((CONTEXT_CHANNELS, 256), (512, 128), (256, 64), (128, 64))
        self.skip_norms = nn.ModuleList(nn.LayerNorm(width) for width in SKIP_CHANNELS)
        self.embeddings = nn.ModuleList(nn.Conv2d(*pair, 1) for pair in widths)
        self.mix = nn.Sequential(
            nn.Conv2d(sum(width for _, width in widths), 128, 1, bias=False),
            nn.BatchNorm2d(128),
            nn.ReLU(),
            nn.Dropout(0.1),
        )
        self.head = _head(num_classes)

    def forward(self, context: Context, skips: Skips) -> Prediction:
        normed = [
            norm(skip).movedim(-1, 1) for norm, skip in zip(self.skip_norms, skips, strict=True)
        ]
        size = normed[0].shape[-2:]
        scales = zip(self.embeddings, (context, *reversed(normed)), strict=True)
        embedded = [
            F.interpolate(embed(x), size, mode="bilinear", align_corners=False)
            for embed, x in scales
        ]
        return Prediction(logits=self.head(self.mix(torch.cat(embedded, dim=1))).float())


class FactoredBlock(nn.Module):
    """A residual block whose two 3x3 convolutions are a 3x1 and a 1x3 each; first the identity."""

    def __init__(self, channels: int):
        super().__init__()
        *layers, norm = *_factored(channels), nn.ReLU(), *_factored(channels)
        assert isinstance(norm, nn.BatchNorm2d)
        nn.init.zeros_(norm.weight)
        self.branch = nn.Sequential(*layers, norm, nn.Dropout2d(0.2))

    def forward(
        self, x: Float[Tensor, "batch channel height width"]
    ) -> Float[Tensor, "batch channel height width"]:
        return F.relu(x + self.branch(x))


class Enlargement(nn.Sequential):
    """Twice the size: by the nearest, then a 3x3 blur of each channel that training may change."""

    def __init__(self, channels: int):
        blur = nn.Conv2d(channels, channels, 3, padding=1, groups=channels)
        ramp = torch.tensor([1.0, 2.0, 1.0])
        assert blur.bias is not None
        with torch.no_grad():
            blur.weight.copy_(torch.outer(ramp, ramp) / 16)
            blur.bias.zero_()
        super().__init__(nn.Upsample(scale_factor=2, mode="nearest"), blur)


def _factored(channels: int) -> tuple[nn.Module, ...]:
    return (
        nn.Conv2d(channels, channels, (3, 1), padding=(1, 0)),
        nn.ReLU(),
        nn.Conv2d(channels, channels, (1, 3), padding=(0, 1), bias=False),
        nn.BatchNorm2d(channels),
    )


def _head(num_classes: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(SKIP_CHANNELS[0], num_classes, 3, padding=1),
        Enlargement(num_classes),
        Enlargement(num_classes),
    )
