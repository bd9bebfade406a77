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
