"""U-Net features for the plane sweep: Table 1, "MVS + UNet features"."""

from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

from jaxtyping import Float
from torch import Tensor, nn

from mvsam.encoders.fpn import FeaturePyramid
from mvsam.encoders.sam import IMAGE_MEAN, IMAGE_STD
from mvsam.errors import MissingExtraError

DECODER_CHANNELS = (64, 32, 16)
"""Of the last three blocks of the U-Net's decoder, at 1/4, 1/2 and 1/1."""


def unet(encoder: str, num_classes: int) -> Any:
    """segmentation-models-pytorch's U-Net on resnet34 or resnet50, random weights.

    Raises MissingExtraError where that library is not installed.
    """
    try:
        from segmentation_models_pytorch import Unet
    except ModuleNotFoundError as error:
        raise MissingExtraError("this model", "segmentation-models-pytorch", "baselines") from error
    return Unet(encoder, encoder_weights=None, classes=num_classes)


def normalize(
    images: Float[Tensor, "*batch 3 height width"],
) -> Float[Tensor, "*batch 3 height width"]:
    """RGB in [0, 1] with ImageNet's mean and deviation."""
    mean, std = (images.new_tensor(x)[:, None, None] for x in (IMAGE_MEAN, IMAGE_STD))
    return (images - mean) / std


class UNetPyramid(nn.Module):
    """The geometric pyramid plus, at each scale, the decoder's features of a U-Net (`network`).

    The paper puts three of its scales in the place of SAM's and drops its head; that they reach the
    pyramid's widths by 1x1 convolutions is our choice.
    """

    def __init__(
        self,
        geometry: FeaturePyramid,
        network: Any,
        decoder_channels: Sequence[int] = DECODER_CHANNELS,
    ):
        super().__init__()
        self.geometry = geometry
        self.encoder: nn.Module = network.encoder
        self.decoder: nn.Module = network.decoder
        self.projections = nn.ModuleList(
            nn.Conv2d(given, wanted, 1, bias=False)
            for given, wanted in zip(decoder_channels, geometry.channels, strict=True)
        )

    def forward(
        self, images: Float[Tensor, "images 3 height width"]
    ) -> tuple[Float[Tensor, "images _channel _height _width"], ...]:
        """Coarse to fine; RGB in [0, 1], which the U-Net normalises. Sides divisible by 32."""
        semantic = decoder_levels(self.decoder, self.encoder(normalize(images)))[-3:]
        levels = zip(self.geometry(images), self.projections, semantic, strict=True)
        return tuple(level + project(added) for level, project, added in levels)


def decoder_levels(
    decoder: Any, features: Sequence[Float[Tensor, "images _channel _height _width"]]
) -> list[Float[Tensor, "images _channel _height _width"]]:
    """What each block of a U-Net's decoder gives, coarse to fine.

    features: the encoder's, from the picture itself down to the coarsest.
    """
    *skips, x = features[1:]
    sizes = [feature.shape[-2:] for feature in features[-2::-1]]
    levels = []
    for block, size, skip in zip_longest(decoder.blocks, sizes, reversed(skips)):
        x = block(x, *size, skip_connection=skip)
        levels.append(x)
    return levels
