"""What PAD-Net, MTI-Net and MTAN share: two tasks on one picture, and how these are supervised."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from mvsam.loss_terms import cross_entropy, is_depth_known, masked_mean
from mvsam.types import Prediction, Targets

TASKS = ("semantics", "depth")


def task_channels(num_classes: int) -> dict[str, int]:
    """Channels of each task's output: one a class, and one for the metres."""
    return {"semantics": num_classes, "depth": 1}


def as_prediction(
    maps: Mapping[str, Float[Tensor, "batch _channel height width"]],
    auxiliary: tuple[Prediction, ...] = (),
) -> Prediction:
    """Maps by task as a prediction of their size."""
    return Prediction(
        depth=maps["depth"][:, 0].float(), logits=maps["semantics"].float(), auxiliary=auxiliary
    )


def resize_prediction(prediction: Prediction, size: tuple[int, int]) -> Prediction:
    """Depth and logits bilinearly at another (height, width)."""
    assert prediction.depth is not None and prediction.logits is not None
    depth = F.interpolate(prediction.depth[:, None], size, mode="bilinear", align_corners=False)
    logits = F.interpolate(prediction.logits, size, mode="bilinear", align_corners=False)
    return replace(prediction, depth=depth[:, 0], logits=logits)


@dataclass(frozen=True)
class MultiTaskLoss:
    """Cross entropy and L1 of the depth, on the final outputs and on every side output.

    Side outputs are brought to the picture's size first. Weights are those of the released
    PAD-Net, MTI-Net and MTAN on NYUv2 with two tasks.
    """

    semantics_weight: float = 1.0
    depth_weight: float = 1.0
    """Of a mean cost of one metre."""
    class_weights: tuple[float, ...] | None = None
    """Weight of each class in the cross entropy; none: all alike, as published."""

    def __call__(
        self, prediction: Prediction, targets: Targets, depth_range: Float[Tensor, "batch 2"]
    ) -> dict[str, Float[Tensor, ""]]:
        """`loss` and its parts `segmentation` and `depth`, each summed over all outputs."""
        size = (targets.depth.shape[-2], targets.depth.shape[-1])
        known = is_depth_known(targets.depth, depth_range)
        segmentation = depth = targets.depth.new_zeros(())
        for output in (prediction, *prediction.auxiliary):
            output = resize_prediction(output, size)
            assert output.depth is not None and output.logits is not None
            segmentation = segmentation + cross_entropy(
                output.logits, targets.labels, self.class_weights
            )
            depth = depth + masked_mean((output.depth - targets.depth).abs(), known)
        total = self.semantics_weight * segmentation + self.depth_weight * depth
        return {"loss": total, "segmentation": segmentation, "depth": depth}


def shortcut(in_channels: int, out_channels: int) -> nn.Sequential | None:
    """A residual block's way around: 1x1 and batch norm where the widths differ, else nothing."""
    if in_channels == out_channels:
        return None
    return nn.Sequential(
        nn.Conv2d(in_channels, out_channels, 1, bias=False), nn.BatchNorm2d(out_channels)
    )


class ScaleFusion(nn.Sequential):
    """Features of several scales, concatenated at the finest and mixed by a 1x1 convolution."""

    def __init__(self, channels: int):
        """`channels`: of all scales together."""
        super().__init__(nn.Conv2d(channels, channels, 1), nn.BatchNorm2d(channels), nn.ReLU())

    def forward(
        self, scales: Sequence[Float[Tensor, "batch _channel _height _width"]]
    ) -> Float[Tensor, "batch channel height width"]:
        """Finest scale first."""
        size = scales[0].shape[-2:]
        resized = [F.interpolate(x, size, mode="bilinear", align_corners=False) for x in scales]
        return super().forward(torch.cat(resized, dim=1))


class Distillation(nn.Module):
    """Each task's features plus what a gate lets through of the other's.

    PAD-Net's third kind of distillation (Xu et al., CVPR 2018); MTI-Net has it at every scale.
    """

    def __init__(self, channels: int):
        super().__init__()
        self.message = nn.ModuleDict({task: _conv3x3(channels) for task in TASKS})
        self.gate = nn.ModuleDict({task: _conv3x3(channels) for task in TASKS})

    def forward(
        self, features: Mapping[str, Float[Tensor, "batch channel height width"]]
    ) -> dict[str, Float[Tensor, "batch channel height width"]]:
        semantics, depth = TASKS
        told = {t: self.message[t](x) * self.gate[t](x).sigmoid() for t, x in features.items()}
        return {
            semantics: features[semantics] + told[depth],
            depth: features[depth] + told[semantics],
        }


def _conv3x3(channels: int) -> nn.Conv2d:
    return nn.Conv2d(channels, channels, 3, padding=1, bias=False)
