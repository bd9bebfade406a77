"""Runs a model over samples under a named protocol and reports scores per scene and in total."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float, Shaped
from rich.table import Table
from torch import Tensor, nn

from mvsam.evaluation.metrics import ConfusionMatrix, DepthMetrics
from mvsam.evaluation.protocols import Protocol, Size
from mvsam.evaluation.sparsification import Sparsification
from mvsam.precision import Precision, autocast
from mvsam.types import Prediction, Targets, Views

Model = Callable[[Views], Prediction]
Sample = tuple[str | Sequence[str], Views, Targets]
"""(scene name, or one for each batch item; views; ground truth of view 0)."""


@dataclass(frozen=True)
class SceneScores:
    """What was counted in one scene, or in several added up; a task nobody predicted is None."""

    num_images: int = 0
    depth: DepthMetrics | None = None
    labels: ConfusionMatrix | None = None
    confidence: Sparsification | None = None

    def __add__(self, other: "SceneScores") -> "SceneScores":
        return SceneScores(
            self.num_images + other.num_images,
            _merge(self.depth, other.depth),
            _merge(self.labels, other.labels),
            _merge(self.confidence, other.confidence),
        )

    def as_json(self) -> dict:
        """Metres and fractions 0..1; what is absent is None."""
        depth = (self.depth or DepthMetrics()).scores()
        pooled = depth.pop("rmse_pooled")
        labels = self.labels
        return depth | {
            "miou": labels.miou() if labels else None,
            "rmse_pooled": pooled,
            "ause": self.confidence.score() if self.confidence else None,
            "accuracy": labels.accuracy() if labels else None,
            "iou": labels.iou() if labels else None,
            "num_images": self.num_images,
        }


def _merge(first, second):
    """The sum of two accumulators, either of which may be None."""
    return second if first is None else first if second is None else first + second


@dataclass(frozen=True)
class Scores:
    """The scores of one model under one protocol."""

    protocol: str
    scenes: dict[str, SceneScores] = field(default_factory=dict)

    @property
    def total(self) -> SceneScores:
        """Depth as the mean over all images, mIoU from one confusion matrix over all scenes."""
        return sum(self.scenes.values(), SceneScores())

    def __add__(self, other: "Scores") -> "Scores":
        """Joins the shares of several processes."""
        assert self.protocol == other.protocol
        scenes = dict(self.scenes)
        for name, scores in other.scenes.items():
            scenes[name] = scenes.get(name, SceneScores()) + scores
        return Scores(self.protocol, scenes)

    def as_json(self) -> dict:
        """The object of `mvsam eval --json`, `metrics.json` and `results/*.json`."""
        scenes = {name: scores.as_json() for name, scores in self.scenes.items()}
        return {"protocol": self.protocol, **self.total.as_json(), "scenes": scenes}

    def as_table(self) -> Table:
        """For the terminal: one row a scene, the total last."""
        table = Table(title=f"protocol: {self.protocol}")
        table.add_column("scene")
        for title in (
            "images",
            "Abs cm",
            "Rel %",
            "RMSE cm",
            "<1.03 %",
            "<1.05 %",
            "<1.25 %",
            "mIoU %",
            "AUSE %",
        ):
            table.add_column(title, justify="right")
        for name, scores in self.scenes.items():
            table.add_row(name, *_cells(scores))
        table.add_section()
        table.add_row("total", *_cells(self.total), style="bold")
        return table


def _cells(scores: SceneScores) -> list[str]:
    values = scores.as_json()
    keys = ("abs", "rel", "rmse", "delta_1.03", "delta_1.05", "delta_1.25", "miou", "ause")
    percent = ["-" if values[key] is None else f"{100 * values[key]:.1f}" for key in keys]
    return [str(scores.num_images), *percent]


def evaluate(
    model: Model,
    samples: Iterable[Sample],
    protocol: Protocol,
    progress: Callable[[int], None] | None = None,
    precision: Precision = "float32",
) -> Scores:
    """Scores of `model` on `samples`, whose ground truth must have the protocol's size.

    An `nn.Module` is switched to evaluation meanwhile, and the samples go to its device.
    `progress` is called with the number of images done so far. `precision` is the model's alone:
    photos are read and resized in float32.
    """
    scenes: dict[str, SceneScores] = {}
    num_done = 0
    with _inference(model) as device:
        for names, views, targets in samples:
            with autocast(device.type, precision):
                prediction = model(views.to(device))
            targets = targets.to(device)
            for item, name in enumerate(_names_of_items(names, len(targets.depth))):
                scores = score_item(prediction, targets, item, protocol)
                scenes[name] = scenes.get(name, SceneScores()) + scores
            num_done += len(targets.depth)
            if progress:
                progress(num_done)
    return Scores(protocol.name, scenes)


def _names_of_items(names: str | Sequence[str], batch: int) -> list[str]:
    return [names] * batch if isinstance(names, str) else list(names)


@contextmanager
def _inference(model: Model) -> Iterator[torch.device]:
    """No gradients, evaluation mode, and the mode of before afterwards; yields the device."""
    if not isinstance(model, nn.Module):
        with torch.inference_mode():
            yield torch.device("cpu")
        return
    parameter = next(model.parameters(), torch.empty(0))
    was_training = model.training
    model.eval()
    try:
        with torch.inference_mode():
            yield parameter.device
    finally:
        model.train(was_training)


def score_item(
    prediction: Prediction, targets: Targets, item: int, protocol: Protocol
) -> SceneScores:
    """The scores of one batch item; the prediction is resized to the truth by nearest pixels."""
    width, height = protocol.truth_size
    if targets.depth.shape[1:] != (height, width):
        raise ValueError(
            f"protocol {protocol.name} wants ground truth of {width}x{height}, "
            f"got {targets.depth.shape[2]}x{targets.depth.shape[1]}"
        )
    labels, logits = prediction.labels, prediction.logits
    label_scores = None
    if labels is not None and logits is not None:
        predicted = at_truth_size(labels[item], protocol.truth_size)
        label_scores = ConfusionMatrix.of_labels(predicted, targets.labels[item], logits.shape[1])
    if prediction.depth is None:
        return SceneScores(1, labels=label_scores)
    depth, confidence = (
        None if maps is None else at_truth_size(maps[item], protocol.truth_size).float()
        for maps in (prediction.depth, prediction.confidence)
    )
    assert depth is not None
    scores = score_depth(depth, confidence, targets.depth[item], protocol)
    return SceneScores(1, labels=label_scores, **scores)


def score_depth(
    depth: Float[Tensor, "height width"],
    confidence: Float[Tensor, "height width"] | None,
    truth: Float[Tensor, "height width"],
    protocol: Protocol,
) -> dict[str, Any]:
    """The fields of `SceneScores` that depth has, and confidence; metres, at the truth's size."""
    valid, compared = protocol.valid_depth(truth), protocol.compared_depth(depth)
    scores: dict[str, Any] = {"depth": DepthMetrics.of_image(compared, truth, valid)}
    if confidence is not None:
        scores["confidence"] = Sparsification.of_image(compared, confidence, truth, valid)
    return scores


def at_truth_size(
    values: Shaped[Tensor, "height width"], size: Size
) -> Shaped[Tensor, "new_height new_width"]:
    """Each new pixel's value is that of the old pixel which holds its centre."""
    if values.shape == (size[1], size[0]):
        return values
    resized = F.interpolate(values[None, None].double(), size[::-1], mode="nearest-exact")
    return resized[0, 0].to(values.dtype)
