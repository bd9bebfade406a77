"""SegNet (Badrinarayanan et al., TPAMI 2017): 29,454,548 parameters for 20 classes.

VGG-16 and its mirror image, which puts every value back where its maximum was found.
"""

from itertools import pairwise

import torch.nn.functional as F
from torch import nn
from torchvision.ops import Conv2dNormActivation

from mvsam.baselines.backbones import vgg16
from mvsam.baselines.imagenet import reference_image
from mvsam.types import Model, Prediction, Views

DECODER = (
    (512, 512, 512, 512),
    (512, 512, 512, 256),
    (256, 256, 256, 128),
    (128, 128, 64),
    (64, 64),
)
"""Channels in and out of the 3x3 convolutions after each unpooling; one more gives the classes."""


class SegNet(Model):
    """Semantics of view 0 alone.

    imagenet: weights of the encoder, see `load_imagenet`.
    """

    def __init__(self, num_classes: int = 20, imagenet: str | None = None):
        super().__init__()
        self.num_classes = num_classes
        self.encoder, self.backbone_weights = vgg16(imagenet)
        for module in self.encoder:
            if isinstance(module, nn.MaxPool2d):
                module.return_indices = True
        self.decoder, self.head = unpooling_decoder(num_classes)

    def forward(self, views: Views) -> Prediction:
        """Logits at the picture's size; sides of at least 32."""
        x, pooled = reference_image(views), []
        for layer in self.encoder:
            if isinstance(layer, nn.MaxPool2d):
                size = x.shape[-2:]
                x, indices = layer(x)
                pooled.append((indices, size))
            else:
                x = layer(x)
        for layers, (indices, size) in zip(self.decoder, reversed(pooled), strict=True):
            x = layers(F.max_unpool2d(x, indices, [2, 2], output_size=size))
        return Prediction(logits=self.head(x).float())


def unpooling_decoder(num_classes: int) -> tuple[nn.ModuleList, nn.Conv2d]:
    """What comes after each unpooling, 14,719,872 parameters, and the layer that gives logits."""
    groups = nn.ModuleList(
        nn.Sequential(*(Conv2dNormActivation(*pair, bias=True) for pair in pairwise(channels)))
        for channels in DECODER
    )
    head = nn.Conv2d(64, num_classes, 3, padding=1)
    for module in (*groups.modules(), head):
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
    return groups, head
