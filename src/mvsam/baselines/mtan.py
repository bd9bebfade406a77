"""MTAN (Liu et al., CVPR 2019) on a dilated ResNet-50 with DeepLab heads: 72,047,573 parameters.

One shared network; each task has its own attention, which picks from it stage after stage. The
publication's own base, SegNet trained from scratch, is unlikely to reach the 56.1 mIoU that the
paper reports, so this is the form with a pre-trained backbone.
"""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torchvision.models.resnet import Bottleneck
from torchvision.models.segmentation.deeplabv3 import DeepLabHead

from mvsam.baselines.backbones import resnet50
from mvsam.baselines.imagenet import reference_image
from mvsam.baselines.multi_task import as_prediction, resize_prediction, shortcut, task_channels
from mvsam.types import Model, Prediction, Views

STAGE_CHANNELS = (256, 512, 1024, 2048)


class Mtan(Model):
    """Depth and semantics of view 0 alone; trained by `MultiTaskLoss`, two or more at a time.

    (The heads normalise a global mean over the batch, which one picture cannot train.)
    imagenet: weights of the backbone, see `load_imagenet`.
    """

    def __init__(self, num_classes: int = 20, imagenet: str | None = None):
        super().__init__()
        self.num_classes = num_classes
        tasks = task_channels(num_classes)
        self.backbone, self.backbone_weights = resnet50(imagenet)
        self.attention = nn.ModuleDict({task: _attention_of_stages() for task in tasks})
        self.refinement = nn.ModuleList(
            Bottleneck(channels, following // 4, downsample=shortcut(channels, following))
            for channels, following in pairwise(STAGE_CHANNELS)
        )
        self.halve = nn.MaxPool2d(2)
        self.head = nn.ModuleDict(
            {task: DeepLabHead(STAGE_CHANNELS[-1], count) for task, count in tasks.items()}
        )

    def forward(self, views: Views) -> Prediction:
        """Depth and logits at the picture's size; sides must be divisible by 8."""
        shared = self._shared_features(reference_image(views, divisor=8))
        final = {
            task: head(self._attend([*self.attention[task].children()], shared))
            for task, head in self.head.items()
        }
        return resize_prediction(as_prediction(final), (views.height, views.width))

    def _shared_features(self, image: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Of each stage: what goes into its last block and what comes out."""
        out = self.backbone.stem(image)
        features = []
        for stage in self.backbone.stages:
            *blocks, last = stage.children()
            before = nn.Sequential(*blocks)(out)
            out = last(before)
            features.append((before, out))
        return features

    def _attend(self, masks: Sequence[nn.Module], shared: list[tuple[Tensor, Tensor]]) -> Tensor:
        """One task's way through the stages: its mask on each, the refined result to the next."""
        before, out = shared[0]
        attended = masks[0](before) * out
        for stage, (before, out) in enumerate(shared[1:], start=1):
            refined = self.refinement[stage - 1](attended)
            if stage == 1:
                refined = self.halve(refined)  # the only later stage that shrinks
            attended = masks[stage](torch.cat([before, refined], dim=1)) * out
        return attended


def _attention_of_stages() -> nn.ModuleList:
    """Masks in 0..1; from the second stage on they also see the task's features so far."""
    first, *later = STAGE_CHANNELS
    return nn.ModuleList([_mask(first, first), *(_mask(2 * width, width) for width in later)])


def _mask(in_channels: int, channels: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(in_channels, channels // 4, 1),
        nn.BatchNorm2d(channels // 4),
        nn.ReLU(),
        nn.Conv2d(channels // 4, channels, 1),
        nn.BatchNorm2d(channels),
        nn.Sigmoid(),
    )
