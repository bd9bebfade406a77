"""Table 6: depth maps side by side, a row a method and a column a scene."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from mvsam.apps.tables.figure import pyplot, save
from mvsam.convolution import fold_batch_norm
from mvsam.data.catalog import open_data
from mvsam.data.dataset import TupleDataset
from mvsam.errors import InputError
from mvsam.evaluation.protocols import PROTOCOLS
from mvsam.experiments.results import read_measured
from mvsam.experiments.row_training import Folders
from mvsam.experiments.rows import Budget
from mvsam.experiments.runs import BUDGETS
from mvsam.experiments.tables import PICTURE_ROWS, PICTURE_SCENES
from mvsam.inference.pictures import depth_colors, depth_limits
from mvsam.types import Scene, Targets, Views
from mvsam.weights import load

DepthMap = Float[np.ndarray, "height width"]


@dataclass(frozen=True)
class PictureRow:
    """A method's depth of each scene; None where it was not trained."""

    method: str
    depths: list[DepthMap] | None


@dataclass(frozen=True)
class Pictures:
    """What the grid shows."""

    titles: list[str]
    photos: list[np.ndarray]
    truth: list[DepthMap]
    rows: list[PictureRow]


def collect(budget: Budget, folders: Folders) -> Pictures:
    """Photos, true depth, and the predictions of those methods that are trained (first seed)."""
    columns = _columns(budget)
    samples = [sample for _, sample in columns]
    rows = []
    for method, name in PICTURE_ROWS:
        run = BUDGETS[budget][name]
        weights = folders.weights(run, seed=0)
        measured = read_measured(folders.results, run)
        if not weights.exists():
            rows.append(PictureRow(f"{method}\nmissing", None))
            continue
        is_short = measured is None or measured.pictures < run.enough
        label = f"{method}\nnot converged" if is_short else method
        rows.append(PictureRow(label, _predictions(weights, [views for views, _ in samples])))
    return Pictures(
        [title for title, _ in columns],
        [views.images[0, 0].permute(1, 2, 0).numpy() for views, _ in samples],
        [targets.depth[0].numpy() for _, targets in samples],
        rows,
    )


def _columns(budget: Budget) -> list[tuple[str, tuple[Views, Targets]]]:
    """(title, sample): the paper's scenes, or the first rooms of the test split."""
    run = BUDGETS[budget]["base"]
    protocol = PROTOCOLS[run.protocol]
    if budget == "rooms":
        wanted = [*open_data("rooms:test:0-6", cache=run.experiment.data.cache)]
    else:
        scenes = {scene.name: scene for scene in open_data(run.scored_on)}
        if absent := sorted(set(PICTURE_SCENES) - set(scenes)):
            raise InputError(f"{run.scored_on} lacks scenes of Table 6: {', '.join(absent)}.")
        wanted = [scenes[name] for name in PICTURE_SCENES]
    times = Counter(scene.name for scene in wanted)
    seen: Counter[str] = Counter()
    columns = []
    for scene in wanted:
        seen[scene.name] += 1
        title = f"{scene.name} ({seen[scene.name]})" if times[scene.name] > 1 else scene.name
        share = seen[scene.name] / (times[scene.name] + 1)
        columns.append((title, _sample(scene, share, run.views, protocol.size)))
    return columns


def _sample(
    scene: Scene, share: float, num_views: int, size: tuple[int, int]
) -> tuple[Views, Targets]:
    """The tuple so far into the scene."""
    tuples = TupleDataset([scene], num_views, size)
    _, views, targets = tuples[int(share * len(tuples))]
    return views, targets


def _predictions(weights: Path, views: list[Views]) -> list[DepthMap]:
    model = fold_batch_norm(load(str(weights)))
    with torch.inference_mode():
        depths = [model(each).depth for each in views]
    return [depth[0].float().numpy() for depth in depths if depth is not None]


def draw_grid(pictures: Pictures, path: Path) -> None:
    """Every column in the colours of its own true depth, red near and blue far."""
    plt = pyplot()
    shown: list[tuple[str, list[np.ndarray] | None]] = [("Target view", pictures.photos)]
    limits = [depth_limits(depth) for depth in pictures.truth]
    for row in (*pictures.rows, PictureRow("GT depth", pictures.truth)):
        colored = row.depths and [
            depth_colors(depth, *ends) for depth, ends in zip(row.depths, limits, strict=True)
        ]
        shown.append((row.method, colored))
    count = len(pictures.titles)
    size = (1.0 + 1.6 * count, 1.35 * len(shown) + 0.3)
    figure, axes = plt.subplots(
        len(shown), count, figsize=size, squeeze=False, layout="constrained"
    )
    for line, (label, cells) in zip(axes, shown, strict=True):
        for place, axis in enumerate(line):
            _cell(axis, None if cells is None else cells[place])
        line[0].set_ylabel(label, fontsize=8)
    for axis, title in zip(axes[0], pictures.titles, strict=True):
        axis.set_title(title, fontsize=7)
    save(figure, path)
    plt.close(figure)


def _cell(axis: Any, picture: np.ndarray | None) -> None:
    axis.set_xticks([])
    axis.set_yticks([])
    if picture is None:
        axis.text(0.5, 0.5, "missing", ha="center", va="center", fontsize=7)
    else:
        axis.imshow(picture)
