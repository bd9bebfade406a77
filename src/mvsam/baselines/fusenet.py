"""FuseNet SF5 (Hazirbas et al., ACCV 2016): 44,176,532 parameters for 20 classes.

SegNet with a second VGG-16 that sees the measured depth; what it finds is added to the picture's
features before each of the five poolings.
"""

from typing import cast

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from mvsam.baselines.backbones import vgg16
from mvsam.baselines.imagenet import reference_image
from mvsam.baselines.measured import measured_depth
from mvsam.baselines.segnet import unpooling_decoder
from mvsam.types import Model, Prediction, Views

DROPOUT_SCALES = 3
"""So many of the coarsest scales have dropout, on the way down and on the way up."""


class FuseNet(Model):
    """Semantics of view 0 from its picture and its measured depth.

    imagenet: weights of both encoders, see `load_imagenet`; the depth's first convolution takes
    their mean over the colours. They are those of VGG-16 with batch norm, where the publication
    had to put fresh ones in.
    """

    reads_depth = True

    def __init__(self, num_classes: int = 20, imagenet: str | None = None):
        super().__init__()
        self.num_classes = num_classes
        self.color_encoder, self.backbone_weights = vgg16(imagenet)
        self.depth_encoder, _ = vgg16(imagenet)
        self.depth_encoder[0] = _for_one_channel(cast(nn.Conv2d, self.depth_encoder[0]))
        for module in self.color_encoder:
            if isinstance(module, nn.MaxPool2d):
                module.return_indices = True
        self.decoder, self.head = unpooling_decoder(num_classes)
        self.dropout = nn.Dropout(0.5)

    def forward(self, views: Views) -> Prediction:
        """Logits at the picture's size; sides of at least 32."""
        color, depth, pooled = reference_image(views), depth_in_bytes(views), []
        for color_layer, depth_layer in zip(self.color_encoder, self.depth_encoder, strict=True):
            depth_before, depth = depth, depth_layer(depth)
            if isinstance(color_layer, nn.MaxPool2d):
                size = color.shape[-2:]
                color, indices = color_layer(color + depth_before)
                pooled.append((indices, size))
                if len(pooled) > len(self.decoder) - DROPOUT_SCALES:
                    color, depth = self.dropout(color), self.dropout(depth)
            else:
                color = color_layer(color)
        for layers in self.decoder:
            indices, size = pooled.pop()
            color = layers(F.max_unpool2d(color, indices, [2, 2], output_size=size))
            if len(pooled) >= len(self.decoder) - DROPOUT_SCALES:
                color = self.dropout(color)
        return Prediction(logits=self.head(color).float())


def depth_in_bytes(views: Views) -> Float[Tensor, "batch 1 height width"]:
    """Measured depth from 0 (unknown) to 255 at d_max, which the sources leave open."""
    far = views.depth_range[:, 1, None, None, None]
    return 255 * (measured_depth(views) / far).clamp(max=1)


def _for_one_channel(convolution: nn.Conv2d) -> nn.Conv2d:
    single = nn.Conv2d(1, convolution.out_channels, 3, padding=1)
    single.load_state_dict(
        convolution.state_dict() | {"weight": convolution.weight.detach().mean(1, keepdim=True)}
    )
    return single
