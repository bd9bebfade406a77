"""Constant answers, which any model has to beat: the median depth and the most frequent label."""

from collections.abc import Iterable
from dataclasses import dataclass

import torch

from mvsam.evaluation.protocols import Protocol
from mvsam.types import IGNORE, Prediction, Targets, Views


@dataclass(frozen=True)
class ConstantMedianDepth:
    """Says the same depth (metres) everywhere."""

    depth: float

    def __call__(self, views: Views) -> Prediction:
        shape = (len(views.images), views.height, views.width)
        return Prediction(depth=torch.full(shape, self.depth, device=views.images.device))


@dataclass(frozen=True)
class MeasuredMedianDepth:
    """Says the median of the true depth of each image: no constant does better in Abs.

    It peeks at the answer (`views.measured_depth`) and is a yardstick for scenes of unlike sizes.
    """

    protocol: Protocol

    def __call__(self, views: Views) -> Prediction:
        if views.measured_depth is None:
            raise ValueError("this yardstick needs the measured depth of the reference")
        middle = views.depth_range.mean(dim=1)
        depth = torch.empty_like(views.measured_depth)
        for item, measured in enumerate(views.measured_depth):
            valid = measured[self.protocol.valid_depth(measured)]
            depth[item] = valid.median() if len(valid) else middle[item]
        return Prediction(depth=depth)


@dataclass(frozen=True)
class MajorityLabel:
    """Says the same class everywhere."""

    label: int
    num_classes: int = 20

    def __call__(self, views: Views) -> Prediction:
        logits = torch.zeros(
            len(views.images),
            self.num_classes,
            views.height,
            views.width,
            device=views.images.device,
        )
        logits[:, self.label] = 1
        return Prediction(logits=logits)


def median_depth(targets: Iterable[Targets], protocol: Protocol) -> float | None:
    """Median over all valid pixels of all images, metres; None if there is none."""
    valid = [t.depth[protocol.valid_depth(t.depth)] for t in targets]
    pooled = torch.cat(valid) if valid else torch.empty(0)
    return pooled.median().item() if len(pooled) else None


def majority_label(targets: Iterable[Targets]) -> int | None:
    """The most frequent class over all labelled pixels; None if there is none."""
    counts = sum(
        (torch.bincount(t.labels.flatten().long(), minlength=IGNORE + 1) for t in targets),
        torch.zeros(IGNORE + 1, dtype=torch.int64),
    )
    counts = counts[:IGNORE]
    return int(counts.argmax()) if counts.any() else None
