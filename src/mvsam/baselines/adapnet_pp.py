"""AdapNet++ (Valada et al., IJCV 2020): 30,163,830 parameters for 20 classes.

A pre-activation ResNet-50 whose later units look at two scales at once, a pyramid of dilated
convolutions at 1/16, and a decoder that takes two skips in. `ssma.py` fuses two of its encoders.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from mvsam.baselines.imagenet import reference_image
from mvsam.loss_terms import cross_entropy
from mvsam.types import Model, Prediction, Targets, Views

WIDTH = 256
"""Channels of the encoder's output and of the decoder."""
SKIP_WIDTH = 24

Rates = tuple[int, ...]
Encoded = tuple[Tensor, Tensor, Tensor]
"""Features at 1/16, skips at 1/8 and 1/4."""


class AdapNetPP(Model):
    """Semantics of view 0 alone, trained by `AdapNetPPLoss`, two or more at a time.

    (The encoder normalises a global mean over the batch, which one picture cannot train.) The
    publication begins with ImageNet weights of its own network, which are not to be had here, and
    leaves pictures (BGR) as they are to the batch norm at its input; ours come normalised.
    `Prediction.auxiliary` holds the side outputs at 1/4 and at 1/8; their 10,320 parameters come
    on top. `rates`: see `Encoder`.
    """

    def __init__(self, num_classes: int = 20, rates: Sequence[Rates] = ((1, 2), (1, 2), (2, 2))):
        super().__init__()
        self.num_classes = num_classes
        self.encoder = Encoder(rates)
        self.decoder = Decoder(num_classes, [Concatenation(), Concatenation()])
        initialize(self)

    def forward(self, views: Views) -> Prediction:
        """Logits at the picture's size; sides must be divisible by 16."""
        return self.decoder(self.encoder(reference_image(views, divisor=16)))


class Encoder(nn.Module):
    """25,562,918 parameters.

    rates: the two dilations inside the multi-scale units of blocks 2, 3 and 4; those of the
    release, which are smaller than the publication's.
    """

    def __init__(self, rates: Sequence[Rates] = ((1, 2), (1, 2), (2, 2))):
        super().__init__()
        two, three, four = rates
        self.stem = nn.Sequential(
            batch_norm(3),
            *conv_block(3, 64, 7, stride=2),
            nn.ZeroPad2d((0, 1, 0, 1)),
            nn.MaxPool2d(3, 2),
        )
        self.blocks = nn.ModuleList(
            nn.Sequential(*units, batch_norm(channels), nn.ReLU())
            for channels, units in (
                (256, [_first_unit(), _unit(256), _unit(256)]),
                (512, [_projection(512, stride=2), _unit(512), _unit(512), _unit(512, two)]),
                (
                    1024,
                    [
                        _projection(1024, stride=2),
                        _unit(1024),
                        *(_unit(1024, three) for _ in range(4)),
                    ],
                ),
                (2048, [_projection(2048, four), _unit(2048, four), _unit(2048, four, 0.7)]),
            )
        )
        self.skips = nn.ModuleList(
            nn.Sequential(*_convolution(channels, SKIP_WIDTH), batch_norm(SKIP_WIDTH))
            for channels in (256, 512)
        )
        self.pyramid = EfficientPyramid(2048)

    def forward(self, images: Float[Tensor, "batch 3 height width"]) -> Encoded:
        x, outputs = self.stem(images), []
        for block in self.blocks:
            x = block(x)
            outputs.append(x)
        finer, coarser = (skip(y) for skip, y in zip(self.skips, outputs[:2], strict=True))
        return self.pyramid(x), coarser, finer


class EfficientPyramid(nn.Module):
    """A 1x1 convolution, three pairs of dilated ones and the global mean, mixed to `WIDTH`."""

    def __init__(self, in_channels: int):
        super().__init__()
        narrow = WIDTH // 4
        self.branches = nn.ModuleList(
            nn.Sequential(
                *conv_block(in_channels, narrow),
                *conv_block(narrow, narrow, 3, rate=rate),
                *conv_block(narrow, narrow, 3, rate=rate),
                *conv_block(narrow, WIDTH),
            )
            for rate in (3, 6, 12)
        )
        self.direct = nn.Sequential(*conv_block(in_channels, WIDTH))
        self.mean = nn.Sequential(nn.AdaptiveAvgPool2d(1), *conv_block(in_channels, WIDTH))
        self.mix = nn.Sequential(*_convolution(5 * WIDTH, WIDTH), batch_norm(WIDTH))

    def forward(
        self, x: Float[Tensor, "batch channel height width"]
    ) -> Float[Tensor, "batch 256 height width"]:
        scales = [branch(x) for branch in (self.direct, *self.branches)]
        return self.mix(torch.cat([*scales, self.mean(x).expand_as(scales[0])], dim=1))


class Concatenation(nn.Module):
    """How AdapNet++'s decoder takes a skip in."""

    def forward(
        self,
        x: Float[Tensor, "batch channel height width"],
        skip: Float[Tensor, "batch skip_channel height width"],
    ) -> Float[Tensor, "batch joined height width"]:
        return torch.cat([x, skip], dim=1)


class Decoder(nn.Module):
    """From 1/16 to the picture's size: 4,600,912 parameters for 20 classes, and two side heads.

    joins: how the skips at 1/8 and at 1/4 are taken in; both give `WIDTH + SKIP_WIDTH` channels.
    """

    def __init__(self, num_classes: int, joins: Sequence[nn.Module]):
        super().__init__()
        self.joins = nn.ModuleList(joins)
        self.enlarge = nn.ModuleList(nn.Sequential(*_enlargement(WIDTH, 2)) for _ in joins)
        self.refine = nn.ModuleList(
            nn.Sequential(*conv_block(WIDTH + SKIP_WIDTH, WIDTH, 3), *conv_block(WIDTH, WIDTH, 3))
            for _ in joins
        )
        self.head = nn.Sequential(*conv_block(WIDTH, num_classes), *_enlargement(num_classes, 4))
        self.auxiliary_heads = nn.ModuleList(
            nn.Sequential(*_convolution(WIDTH, num_classes), batch_norm(num_classes)) for _ in joins
        )

    def forward(self, encoded: Encoded) -> Prediction:
        """The side outputs are those of the last enlargement first."""
        x, *skips = encoded
        sides: list[Prediction] = []
        layers = zip(self.enlarge, self.joins, self.refine, self.auxiliary_heads, strict=True)
        for skip, (enlarge, join, refine, side) in zip(skips, layers, strict=True):
            x = enlarge(x)
            sides.append(Prediction(logits=side(x).float()))
            x = refine(join(x, skip))
        return Prediction(logits=self.head(x).float(), auxiliary=tuple(reversed(sides)))


@dataclass(frozen=True)
class AdapNetPPLoss:
    """Cross entropy of the logits and, at the picture's size, of the side outputs.

    The release averages over all pixels; here the mean is over the labelled ones.
    """

    auxiliary_weights: tuple[float, ...] = (0.6, 0.5)
    """Of the outputs at 1/4 and at 1/8."""
    class_weights: tuple[float, ...] | None = None
    """Weight of each class in the cross entropy; none: all alike, as published."""

    def __call__(
        self, prediction: Prediction, targets: Targets, depth_range: Float[Tensor, "batch 2"]
    ) -> dict[str, Float[Tensor, ""]]:
        """`loss` and its parts `segmentation` and `auxiliary`, weighted."""
        assert prediction.logits is not None
        segmentation = cross_entropy(prediction.logits, targets.labels, self.class_weights)
        auxiliary, size = segmentation.new_zeros(()), prediction.logits.shape[-2:]
        for side, weight in zip(prediction.auxiliary, self.auxiliary_weights, strict=True):
            assert side.logits is not None
            logits = F.interpolate(side.logits, size, mode="bilinear", align_corners=False)
            auxiliary = auxiliary + weight * cross_entropy(
                logits, targets.labels, self.class_weights
            )
        return {
            "loss": segmentation + auxiliary,
            "segmentation": segmentation,
            "auxiliary": auxiliary,
        }


def initialize(model: nn.Module) -> None:
    """He's normal weights, none beyond two deviations."""
    for module in model.modules():
        if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
            deviation = (2 / module.weight[0].numel()) ** 0.5
            nn.init.trunc_normal_(module.weight, std=deviation, a=-2 * deviation, b=2 * deviation)


class Sum(nn.Module):
    """What a shortcut and a branch make of one input, added up."""

    def __init__(self, shortcut: nn.Module, *branch: nn.Module):
        super().__init__()
        self.shortcut = shortcut
        self.branch = nn.Sequential(*branch)

    def forward(
        self, x: Float[Tensor, "batch _channel _height _width"]
    ) -> Float[Tensor, "batch channel height width"]:
        return self.shortcut(x) + self.branch(x)


class MultiRate(nn.Module):
    """3x3 convolutions of several dilations, each with its share of the channels."""

    def __init__(self, channels: int, rates: Rates, stride: int):
        super().__init__()
        share = channels // len(rates)
        self.convolutions = nn.ModuleList(
            nn.Sequential(*conv_block(channels, share, 3, stride, rate)) for rate in rates
        )

    def forward(
        self, x: Float[Tensor, "batch channel _height _width"]
    ) -> Float[Tensor, "batch channel height width"]:
        return torch.cat([convolution(x) for convolution in self.convolutions], dim=1)


def _first_unit() -> nn.Sequential:
    """Its shortcut begins after its first convolution."""
    shortcut = nn.Sequential(*_convolution(64, 256))
    return nn.Sequential(*conv_block(64, 64), Sum(shortcut, *_spatial(256)))


def _projection(channels: int, rates: Rates = (1,), stride: int = 1) -> Sum:
    """Doubles the channels of an input that is activated already.

    The sources do not say which convolution strides; here it is the 3x3.
    """
    shortcut = nn.Sequential(*_convolution(channels // 2, channels, stride=stride))
    narrow = conv_block(channels // 2, channels // 4)
    return Sum(shortcut, *narrow, *_spatial(channels, rates, stride))


def _unit(channels: int, rates: Rates = (1,), dropout: float = 0.0) -> Sum:
    activation = (batch_norm(channels), nn.ReLU())
    narrow = conv_block(channels, channels // 4)
    return Sum(nn.Identity(), *activation, *narrow, *_spatial(channels, rates), nn.Dropout(dropout))


def _spatial(channels: int, rates: Rates = (1,), stride: int = 1) -> list[nn.Module]:
    narrow = channels // 4
    return [MultiRate(narrow, rates, stride), *_convolution(narrow, channels)]


def conv_block(
    in_channels: int, out_channels: int, kernel: int = 1, stride: int = 1, rate: int = 1
) -> list[nn.Module]:
    layers = _convolution(in_channels, out_channels, kernel, stride, rate)
    return [*layers, batch_norm(out_channels), nn.ReLU()]


def _convolution(
    in_channels: int, out_channels: int, kernel: int = 1, stride: int = 1, rate: int = 1
) -> list[nn.Module]:
    """Padded as TensorFlow's SAME does: of an odd number of zeros the last side gets more."""
    zeros = max(rate * (kernel - 1) + 1 - stride, 0)
    convolution = nn.Conv2d(
        in_channels, out_channels, kernel, stride, zeros // 2, dilation=rate, bias=False
    )
    return [nn.ZeroPad2d((0, 1, 0, 1)), convolution] if zeros % 2 else [convolution]


def _enlargement(channels: int, factor: int) -> list[nn.Module]:
    kernel, crop = 2 * factor, factor // 2
    layer = nn.ConvTranspose2d(channels, channels, kernel, factor, crop, bias=False)
    return [layer, batch_norm(channels)]


def batch_norm(channels: int) -> nn.BatchNorm2d:
    return nn.BatchNorm2d(channels, momentum=0.01)
