"""MTI-Net (Vandenhende et al., ECCV 2020) on HRNet-W18-small-v2: 8,567,279 parameters.

Both tasks are predicted at four scales, coarse to fine. What the tasks learn together at one scale
is passed to the next finer; at each scale they inform each other as in PAD-Net.
"""

from collections.abc import Mapping, Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torchvision.models.resnet import BasicBlock
from torchvision.ops import SqueezeExcitation

from mvsam.baselines.backbones import HRNET_CHANNELS, hrnet_w18_small_v2
from mvsam.baselines.imagenet import reference_image
from mvsam.baselines.multi_task import (
    TASKS,
    Distillation,
    ScaleFusion,
    as_prediction,
    resize_prediction,
    shortcut,
    task_channels,
)
from mvsam.types import Model, Prediction, Views


class InitialPrediction(nn.Module):
    """Features of each task at one scale, and what they alone would predict."""

    def __init__(self, in_channels: int, channels: int, tasks: dict[str, int]):
        super().__init__()
        self.features = nn.ModuleDict({task: _two_blocks(in_channels, channels) for task in tasks})
        self.head = nn.ModuleDict(
            {task: nn.Conv2d(channels, count, 1) for task, count in tasks.items()}
        )

    def forward(
        self, inputs: Mapping[str, Float[Tensor, "batch in_channels height width"]]
    ) -> tuple[dict[str, Float[Tensor, "batch channel height width"]], Prediction]:
        features = {task: blocks(inputs[task]) for task, blocks in self.features.items()}
        predicted = {task: head(features[task]) for task, head in self.head.items()}
        return features, as_prediction(predicted)


class FeaturePropagation(nn.Module):
    """What the tasks have in common at one scale, added to each task's own features."""

    def __init__(self, channels: int):
        super().__init__()
        self.groups = (channels, len(TASKS))
        stacked = channels * len(TASKS)
        self.attention = nn.Sequential(
            _two_blocks(stacked, stacked // 4), nn.Conv2d(stacked // 4, stacked, 1)
        )
        self.shared = BasicBlock(stacked, channels, downsample=shortcut(stacked, channels))
        self.gate = nn.ModuleDict(
            {task: SqueezeExcitation(channels, channels // 16) for task in TASKS}
        )

    def forward(
        self, features: Mapping[str, Float[Tensor, "batch channel height width"]]
    ) -> dict[str, Float[Tensor, "batch channel height width"]]:
        stacked = torch.cat([features[task] for task in TASKS], dim=1)
        # The released code groups neighbouring channels, nearly always of one task, where the
        # publication means the tasks against each other.
        weights = self.attention(stacked).unflatten(1, self.groups).softmax(dim=2).flatten(1, 2)
        shared = self.shared(stacked * weights)
        return {task: x + self.gate[task](shared) for task, x in features.items()}


class MtiNet(Model):
    """Depth and semantics of view 0 alone; trained by `MultiTaskLoss`.

    imagenet: weights of the backbone, see `load_imagenet`.
    `Prediction.auxiliary` holds the initial predictions, finest (a quarter of the picture) first.
    """

    def __init__(self, num_classes: int = 20, imagenet: str | None = None):
        super().__init__()
        self.num_classes = num_classes
        tasks = task_channels(num_classes)
        self.backbone, self.backbone_weights = hrnet_w18_small_v2(imagenet)
        passed_down = (*HRNET_CHANNELS[1:], 0)
        self.initial = nn.ModuleList(
            InitialPrediction(channels + passed, channels, tasks)
            for channels, passed in zip(HRNET_CHANNELS, passed_down, strict=True)
        )
        self.propagation = nn.ModuleList(map(FeaturePropagation, HRNET_CHANNELS[1:]))
        self.distillation = nn.ModuleList(map(Distillation, HRNET_CHANNELS))
        fused = sum(HRNET_CHANNELS)
        self.fusion = nn.ModuleDict({task: ScaleFusion(fused) for task in tasks})
        self.head = nn.ModuleDict(
            {task: nn.Conv2d(fused, count, 1) for task, count in tasks.items()}
        )

    def forward(self, views: Views) -> Prediction:
        """Depth and logits at the picture's size; sides must be divisible by 32."""
        scales = self.backbone(reference_image(views, divisor=32))
        features, initial = self._coarse_to_fine(scales)
        distilled = [distil(x) for distil, x in zip(self.distillation, features, strict=True)]
        final = {
            task: self.head[task](fuse([scale[task] for scale in distilled]))
            for task, fuse in self.fusion.items()
        }
        return resize_prediction(as_prediction(final, initial), (views.height, views.width))

    def _coarse_to_fine(
        self, scales: Sequence[Tensor]
    ) -> tuple[list[dict[str, Tensor]], tuple[Prediction, ...]]:
        """Task features and initial predictions of each scale, finest first, as `scales` are."""
        last = len(scales) - 1
        inputs = dict.fromkeys(TASKS, scales[last])
        features, initial = self.initial[last](inputs)
        all_features, all_initial = [features], [initial]
        for finer in reversed(range(last)):
            passed = self.propagation[finer](features)
            inputs = {task: torch.cat([scales[finer], _twice(x)], 1) for task, x in passed.items()}
            features, initial = self.initial[finer](inputs)
            all_features.insert(0, features)
            all_initial.insert(0, initial)
        return all_features, tuple(all_initial)


def _two_blocks(in_channels: int, channels: int) -> nn.Sequential:
    first = BasicBlock(in_channels, channels, downsample=shortcut(in_channels, channels))
    return nn.Sequential(first, BasicBlock(channels, channels))


def _twice(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
