"""Depth and segmentation scores as accumulators that add up over images, scenes and processes."""

from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64, Integer
from torch import Tensor

from mvsam.types import IGNORE

DELTA_THRESHOLDS = (1.03, 1.05, 1.25)


@dataclass(frozen=True)
class DepthMetrics:
    """Sums over images of per-image depth scores; a score is the mean over images.

    Images without a valid pixel count nowhere. `a + b` merges two accumulators.
    """

    num_images: int = 0
    num_pixels: int = 0
    abs: float = 0.0
    """Mean absolute error, metres."""
    rel: float = 0.0
    """Mean absolute error over true depth, a fraction."""
    rmse: float = 0.0
    """Root of the mean squared error, metres."""
    deltas: tuple[float, ...] = (0.0,) * len(DELTA_THRESHOLDS)
    """Fractions of pixels whose ratio to the truth is below each of `DELTA_THRESHOLDS`."""
    squared_error: float = 0.0
    """Over all pixels of all images, square metres; for the pooled RMSE."""

    @staticmethod
    def of_image(
        predicted: Float[Tensor, "height width"],
        truth: Float[Tensor, "height width"],
        valid: Bool[Tensor, "height width"],
    ) -> "DepthMetrics":
        """The scores of one image over its valid pixels, where `truth` must be positive, metres."""
        if not valid.any():
            return DepthMetrics()
        estimate, depth = predicted[valid].double(), truth[valid].double()
        if not torch.isfinite(estimate).all():
            raise ValueError("the predicted depth is not finite; did the training diverge?")
        error = (estimate - depth).abs()
        # A depth of zero or below is infinitely wrong; its ratio must not look small.
        ratio = torch.where(estimate > 0, torch.maximum(estimate / depth, depth / estimate), np.inf)
        return DepthMetrics(
            num_images=1,
            num_pixels=len(depth),
            abs=error.mean().item(),
            rel=(error / depth).mean().item(),
            rmse=error.square().mean().sqrt().item(),
            deltas=tuple((ratio < t).double().mean().item() for t in DELTA_THRESHOLDS),
            squared_error=error.square().sum().item(),
        )

    def __add__(self, other: "DepthMetrics") -> "DepthMetrics":
        sums = {f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)}
        sums["deltas"] = tuple(a + b for a, b in zip(self.deltas, other.deltas, strict=True))
        return DepthMetrics(**sums)

    def scores(self) -> dict[str, float | None]:
        """`abs`, `rel`, `rmse`, `delta_*`, `rmse_pooled`; all None without a valid image."""
        sums = {"abs": self.abs, "rel": self.rel, "rmse": self.rmse}
        sums |= {f"delta_{t}": d for t, d in zip(DELTA_THRESHOLDS, self.deltas, strict=True)}
        if self.num_images == 0:
            return dict.fromkeys([*sums, "rmse_pooled"])
        pooled = (self.squared_error / self.num_pixels) ** 0.5
        return {name: total / self.num_images for name, total in sums.items()} | {
            "rmse_pooled": pooled
        }


@dataclass(frozen=True)
class ConfusionMatrix:
    """Counts of (true class, predicted class); mIoU comes from one matrix over the whole set.

    Pixels whose truth is `IGNORE` count nowhere, not even as false positives. The last column
    counts labelled pixels that the prediction left unlabelled: they are misses of their class.
    """

    counts: Int64[np.ndarray, "num_classes predicted"]

    @staticmethod
    def empty(num_classes: int) -> "ConfusionMatrix":
        return ConfusionMatrix(np.zeros((num_classes, num_classes + 1), np.int64))

    @staticmethod
    def of_labels(
        predicted: Integer[Tensor, "*any"], truth: Integer[Tensor, "*any"], num_classes: int
    ) -> "ConfusionMatrix":
        """The counts of some pixels; labels are 0..num_classes-1 or `IGNORE`."""
        labelled = truth != IGNORE
        rows, columns = truth[labelled].long(), predicted[labelled].long()
        columns = torch.where(columns == IGNORE, num_classes, columns)
        for name, labels, highest in (
            ("true", rows, num_classes - 1),
            ("predicted", columns, num_classes),
        ):
            if labels.numel() and not (labels.min() >= 0 and labels.max() <= highest):
                raise ValueError(
                    f"{name} labels reach from {labels.min()} to {labels.max()}, "
                    f"but there are {num_classes} classes"
                )
        shape = (num_classes, num_classes + 1)
        cells = torch.bincount(rows * shape[1] + columns, minlength=shape[0] * shape[1])
        return ConfusionMatrix(cells.reshape(shape).cpu().numpy())

    @property
    def num_classes(self) -> int:
        return self.counts.shape[0]

    def __add__(self, other: "ConfusionMatrix") -> "ConfusionMatrix":
        return ConfusionMatrix(self.counts + other.counts)

    def iou(self) -> list[float | None]:
        """TP / (TP + FP + FN) of each class; None for a class in neither truth nor prediction."""
        hits = np.diag(self.counts)
        union = self.counts.sum(1) + self.counts[:, :-1].sum(0) - hits
        return [int(h) / int(u) if u else None for h, u in zip(hits, union, strict=True)]

    def miou(self) -> float | None:
        """Mean of `iou` over the classes that have one; None without a labelled pixel."""
        present = [value for value in self.iou() if value is not None]
        return sum(present) / len(present) if present else None

    def accuracy(self) -> float | None:
        """Fraction of labelled pixels that are right; None without any."""
        total = int(self.counts.sum())
        return int(np.trace(self.counts)) / total if total else None


def rel_of_most_confident(
    predicted: Float[Tensor, "height width"],
    confidence: Float[Tensor, "height width"],
    truth: Float[Tensor, "height width"],
    valid: Bool[Tensor, "height width"],
    fraction: float,
) -> float | None:
    """Mean relative error of the given fraction of valid pixels with the highest confidence.

    If confidence means anything, it falls as the fraction falls. None without a valid pixel.
    """
    if not valid.any():
        return None
    order = confidence[valid].argsort(descending=True, stable=True)
    kept = order[: max(1, round(fraction * len(order)))]
    depth = truth[valid][kept].double()
    return ((predicted[valid][kept].double() - depth).abs() / depth).mean().item()
