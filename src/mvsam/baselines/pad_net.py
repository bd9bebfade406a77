"""PAD-Net (Xu et al., CVPR 2018) on HRNet-W18-small-v2, two tasks: 7,008,776 parameters.

Both tasks are predicted once from shared features; the two heads' features then inform each other
and are predicted from again. The publication also predicts edges and normals on the way, which
ScanNet has no truth for.
"""

from torch import nn
from torchvision.models.resnet import Bottleneck

from mvsam.baselines.backbones import HRNET_CHANNELS, hrnet_w18_small_v2
from mvsam.baselines.imagenet import reference_image
from mvsam.baselines.multi_task import (
    Distillation,
    ScaleFusion,
    as_prediction,
    resize_prediction,
    shortcut,
    task_channels,
)
from mvsam.types import Model, Prediction, Views

WIDTH = 256
"""Channels of each task's features."""


class PadNet(Model):
    """Depth and semantics of view 0 alone; trained by `MultiTaskLoss`.

    imagenet: weights of the backbone, see `load_imagenet`.
    `Prediction.auxiliary` holds the initial prediction, at a quarter of the picture.
    """

    def __init__(self, num_classes: int = 20, imagenet: str | None = None):
        super().__init__()
        self.num_classes = num_classes
        channels = task_channels(num_classes)
        fused = sum(HRNET_CHANNELS)
        self.backbone, self.backbone_weights = hrnet_w18_small_v2(imagenet)
        self.fusion = ScaleFusion(fused)
        self.initial = nn.ModuleDict({task: _two_bottlenecks(fused) for task in channels})
        self.initial_head = _heads(channels)
        self.distillation = Distillation(WIDTH)
        self.final = nn.ModuleDict({task: _two_bottlenecks(WIDTH) for task in channels})
        self.final_head = _heads(channels)

    def forward(self, views: Views) -> Prediction:
        """Depth and logits at the picture's size; sides must be divisible by 32."""
        shared = self.fusion(self.backbone(reference_image(views, divisor=32)))
        features = {task: block(shared) for task, block in self.initial.items()}
        initial = {task: head(features[task]) for task, head in self.initial_head.items()}
        distilled = self.distillation(features)
        refined = {task: block(distilled[task]) for task, block in self.final.items()}
        final = {task: head(refined[task]) for task, head in self.final_head.items()}
        prediction = as_prediction(final, auxiliary=(as_prediction(initial),))
        return resize_prediction(prediction, (views.height, views.width))


def _two_bottlenecks(in_channels: int) -> nn.Sequential:
    planes = WIDTH // Bottleneck.expansion
    first = Bottleneck(in_channels, planes, downsample=shortcut(in_channels, WIDTH))
    return nn.Sequential(first, Bottleneck(WIDTH, planes))


def _heads(channels: dict[str, int]) -> nn.ModuleDict:
    return nn.ModuleDict({task: nn.Conv2d(WIDTH, count, 1) for task, count in channels.items()})
