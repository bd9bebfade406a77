"""MT-RefineNet (Nekrasov et al., ICRA 2019) on MobileNetV2: 3,023,957 parameters for 20 classes.

A light-weight RefineNet whose decoder is all 1x1 convolutions and max pooling, shared up to a head
a task.
"""

from dataclasses import dataclass, replace
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn

from mvsam.baselines.backbones import mobilenet_v2
from mvsam.baselines.imagenet import reference_image
from mvsam.baselines.multi_task import as_prediction, resize_prediction, task_channels
from mvsam.loss_terms import cross_entropy, is_depth_known, masked_mean
from mvsam.types import Model, Prediction, Targets, Views

WIDTH = 256
BLOCKS = ((0, 4), (4, 7), (7, 11), (11, 14), (14, 17), (17, 18))
"""Blocks of MobileNetV2 up to each tap."""
TAP_CHANNELS = (24, 32, 64, 96, 160, 320)
TAPS_OF_LEVEL = ((0,), (1,), (2, 3), (4, 5))
"""Taps that meet at 1/4, 1/8, 1/16 and 1/32."""


class ChainedPooling(nn.Module):
    """Adds four times what a 5x5 maximum and a 1x1 convolution make of the last addend."""

    def __init__(self, groups: int = 1):
        super().__init__()
        self.convolutions = nn.ModuleList(
            nn.Conv2d(WIDTH, WIDTH, 1, groups=groups, bias=False) for _ in range(4)
        )
        self.pool = nn.MaxPool2d(5, stride=1, padding=2)

    def forward(
        self, x: Float[Tensor, "batch channel height width"]
    ) -> Float[Tensor, "batch channel height width"]:
        addend = x
        for convolution in self.convolutions:
            addend = convolution(self.pool(addend))
            x = x + addend
        return x


class MtRefineNet(Model):
    """Depth and semantics of view 0 alone; trained by `MtRefineNetLoss`.

    imagenet: weights of the backbone, see `load_imagenet`.
    """

    def __init__(self, num_classes: int = 20, imagenet: str | None = None):
        super().__init__()
        self.num_classes = num_classes
        features, self.backbone_weights = mobilenet_v2(imagenet)
        self.backbone = nn.ModuleList(features[first:last] for first, last in BLOCKS)
        self.projection = nn.ModuleList(_conv1x1(channels) for channels in TAP_CHANNELS)
        self.pooling = nn.ModuleList(
            ChainedPooling(groups=1 if level else WIDTH) for level in range(len(TAPS_OF_LEVEL))
        )
        self.adaptation = nn.ModuleList(_conv1x1(WIDTH) for _ in TAPS_OF_LEVEL[1:])
        self.head = nn.ModuleDict(
            {task: _head(count) for task, count in task_channels(num_classes).items()}
        )
        _initialize(self)

    def forward(self, views: Views) -> Prediction:
        """Depth (not negative) and logits at the picture's size."""
        features = self._decode(self._taps(reference_image(views)))
        maps = {task: head(features) for task, head in self.head.items()}
        prediction = resize_prediction(as_prediction(maps), (views.height, views.width))
        assert prediction.depth is not None
        return replace(prediction, depth=prediction.depth.relu())

    def parameter_groups(self, lr: float) -> list[dict[str, Any]]:
        """`lr` is the backbone's; the decoder learns ten times as fast."""
        backbone = {id(parameter) for parameter in self.backbone.parameters()}
        decoder = [p for p in self.parameters() if id(p) not in backbone]
        return [
            {"params": list(self.backbone.parameters()), "lr": lr},
            {"params": decoder, "lr": 10 * lr},
        ]

    def _taps(self, image: Tensor) -> list[Tensor]:
        x, taps = image, []
        for blocks, projection in zip(self.backbone, self.projection, strict=True):
            x = blocks(x)
            taps.append(projection(x))
        return taps

    def _decode(self, taps: list[Tensor]) -> Tensor:
        """From the coarsest level to a quarter of the picture."""
        coarsest = len(TAPS_OF_LEVEL) - 1
        x = taps[0]
        for level in reversed(range(len(TAPS_OF_LEVEL))):
            merged = torch.stack([taps[tap] for tap in TAPS_OF_LEVEL[level]]).sum(0)
            if level < coarsest:
                size = merged.shape[-2:]
                adapted = self.adaptation[level](x)
                merged = merged + F.interpolate(adapted, size, mode="bilinear", align_corners=False)
            x = self.pooling[level](F.relu6(merged))
        return x


def _conv1x1(in_channels: int) -> nn.Conv2d:
    return nn.Conv2d(in_channels, WIDTH, 1, bias=False)


def _head(out_channels: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(WIDTH, WIDTH, 1, groups=WIDTH, bias=False),
        nn.ReLU6(),
        nn.Conv2d(WIDTH, out_channels, 3, padding=1),
    )


def _initialize(model: MtRefineNet) -> None:
    """Decoder weights of deviation 0.01, as released; depth begins at about a metre.

    The loss cuts depth off at zero, so one that began below would never learn. The backbone keeps
    torchvision's random weights where it has no others: batch norm undoes their scale.
    """
    decoder = (model.projection, model.pooling, model.adaptation, model.head)
    for module in (m for part in decoder for m in part.modules()):
        if isinstance(module, nn.Conv2d):
            nn.init.normal_(module.weight, std=0.01)
    *_, bias = model.head["depth"].parameters()
    nn.init.ones_(bias)


@dataclass(frozen=True)
class MtRefineNetLoss:
    """Cross entropy and reverse Huber of the depth, half each."""

    semantics_weight: float = 0.5
    depth_weight: float = 0.5
    """Of a mean cost of one metre."""
    class_weights: tuple[float, ...] | None = None
    """Weight of each class in the cross entropy; none: all alike, as published."""

    def __call__(
        self, prediction: Prediction, targets: Targets, depth_range: Float[Tensor, "batch 2"]
    ) -> dict[str, Float[Tensor, ""]]:
        """`loss` and its parts `segmentation` and `depth`."""
        assert prediction.depth is not None and prediction.logits is not None
        known = is_depth_known(targets.depth, depth_range)
        segmentation = cross_entropy(prediction.logits, targets.labels, self.class_weights)
        depth = masked_mean(reverse_huber(prediction.depth - targets.depth, known), known)
        total = self.semantics_weight * segmentation + self.depth_weight * depth
        return {"loss": total, "segmentation": segmentation, "depth": depth}


def reverse_huber(
    error: Float[Tensor, "*axes"], mask: Bool[Tensor, "*axes"]
) -> Float[Tensor, "*axes"]:
    """|e| up to c, beyond it (e^2 + c^2) / 2c; c is a fifth of the largest |e| under the mask."""
    size = error.abs()
    turn = 0.2 * size.detach().where(mask, 0).max().clamp(min=1e-6)
    return torch.where(size <= turn, size, (size**2 + turn**2) / (2 * turn))
