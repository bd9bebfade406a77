"""DeepLab v2 (Chen et al., TPAMI 2018) and v3 (Chen et al., 2017) on a dilated ResNet-101.

Both read a wide neighbourhood at 1/8 of the picture through convolutions of several dilations: v2
adds up four of them, v3 mixes three with a global mean. The publications' several scales of input
and random field are left out.
"""

from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torchvision.models.segmentation.deeplabv3 import DeepLabHead

from mvsam.baselines.backbones import resnet101
from mvsam.baselines.imagenet import reference_image
from mvsam.types import Model, Prediction, Views


class SummedDilations(nn.Module):
    """DeepLab v2's head: the sum of four 3x3 convolutions of dilation 6, 12, 18 and 24."""

    def __init__(self, in_channels: int, num_classes: int):
        super().__init__()
        self.convolutions = nn.ModuleList(
            nn.Conv2d(in_channels, num_classes, 3, padding=rate, dilation=rate)
            for rate in (6, 12, 18, 24)
        )
        for name, parameter in self.named_parameters():
            if name.endswith("weight"):
                nn.init.normal_(parameter, std=0.01)
            else:
                nn.init.zeros_(parameter)

    def forward(
        self, x: Float[Tensor, "batch channel height width"]
    ) -> Float[Tensor, "batch num_classes height width"]:
        return torch.stack([convolution(x) for convolution in self.convolutions]).sum(0)


class DeepLabV2(Model):
    """Semantics of view 0 alone: 43,974,800 parameters.

    imagenet: weights of the backbone, see `load_imagenet`; its batch norms then stay as they are,
    as published. (The original's pooling rounds up: 33 x 41 logits where this one has 32 x 40.)
    """

    def __init__(self, num_classes: int = 20, imagenet: str | None = None):
        super().__init__()
        self.num_classes = num_classes
        self.backbone, self.backbone_weights = resnet101(imagenet)
        self.head = SummedDilations(2048, num_classes)
        for norm in self._frozen_norms():
            norm.requires_grad_(False)

    def forward(self, views: Views) -> Prediction:
        """Logits at the picture's size."""
        return _at_picture_size(self.head(self.backbone(reference_image(views))), views)

    def train(self, mode: bool = True) -> "DeepLabV2":
        super().train(mode)
        for norm in self._frozen_norms():
            norm.eval()
        return self

    def parameter_groups(self, lr: float) -> list[dict[str, Any]]:
        """`lr` is the backbone's; the head's weights learn ten times as fast, its biases twenty
        times and undecayed."""
        head = dict(self.head.named_parameters())
        weights = [p for name, p in head.items() if name.endswith("weight")]
        biases = [p for name, p in head.items() if name.endswith("bias")]
        return [
            {"params": [p for p in self.backbone.parameters() if p.requires_grad], "lr": lr},
            {"params": weights, "lr": 10 * lr},
            {"params": biases, "lr": 20 * lr, "weight_decay": 0.0},
        ]

    def _frozen_norms(self) -> list[nn.Module]:
        if self.backbone_weights == "random":
            return []
        return [m for m in self.backbone.modules() if isinstance(m, nn.BatchNorm2d)]


class DeepLabV3(Model):
    """Semantics of view 0 alone: 58,630,740 parameters, torchvision's without its auxiliary head.

    Trained two pictures or more at a time: the head normalises a global mean over the batch.
    imagenet: weights of the backbone, see `load_imagenet`.
    """

    def __init__(self, num_classes: int = 20, imagenet: str | None = None):
        super().__init__()
        self.num_classes = num_classes
        self.backbone, self.backbone_weights = resnet101(imagenet)
        self.head = DeepLabHead(2048, num_classes)

    def forward(self, views: Views) -> Prediction:
        """Logits at the picture's size."""
        return _at_picture_size(self.head(self.backbone(reference_image(views))), views)


def _at_picture_size(logits: Tensor, views: Views) -> Prediction:
    size = (views.height, views.width)
    logits = F.interpolate(logits.float(), size, mode="bilinear", align_corners=False)
    return Prediction(logits=logits)
