"""Measured rows on disk, `results/runs/RUN-SEED.json`, and what several seeds say together."""

import json
import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import mean, stdev
from typing import Any

from mvsam.errors import InputError
from mvsam.experiments.config import Experiment
from mvsam.experiments.rows import RowRun
from mvsam.experiments.tables import METRICS
from mvsam.files import write_json
from mvsam.provenance import provenance

log = logging.getLogger("mvsam")


@dataclass(frozen=True)
class Result:
    """What training a row with one seed gave."""

    run: str
    seed: int
    data: str
    protocol: str
    views: int
    steps: int
    pictures: int
    """References with their truth that it learned from."""
    weights: str
    """What it began with: random, or names of weights."""
    scores: dict[str, Any]
    """As `mvsam eval --json`, without the single scenes."""
    train_seconds: float | None = None
    """None where training was interrupted, or done before."""
    trained_at: str | None = None
    """Commit of the training; the file's own commit is that of the scoring."""
    experiment: dict[str, Any] = field(default_factory=dict)
    """Every setting, as it was trained."""


def result_path(folder: Path, run: str, seed: int) -> Path:
    return folder / f"{run}-{seed}.json"


def write_result(folder: Path, result: Result, device: str) -> Path:
    """Writes it with the command, commit, versions and device; returns the path."""
    path = result_path(folder, result.run, result.seed)
    write_json(path, {**asdict(result), **provenance(device)})
    return path


def read_result(path: Path) -> Result:
    """InputError where the file is none of ours."""
    try:
        content = json.loads(path.read_text())
        names = Result.__dataclass_fields__
        result = Result(**{name: content[name] for name in names if name in content})
        if set(METRICS) - set(result.scores):
            raise KeyError("scores")
        return result
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path} is not the result of a row ({type(error).__name__}: {error}); remove it and "
            "train the row again."
        ) from error


@dataclass(frozen=True)
class Measured:
    """A row as it was measured, over its seeds."""

    seeds: tuple[int, ...]
    steps: int
    pictures: int
    weights: str
    means: dict[str, float | None]
    """By metric; None where the method lacks the task."""
    deviations: dict[str, float | None]
    """Sample standard deviation over the seeds; None for one seed."""


def read_measured(folder: Path, run: RowRun) -> Measured | None:
    """The seeds that were trained longest; None where there is none.

    What was trained or scored with other settings than the row's does not count.
    """
    name = run.experiment.name
    paths = sorted(folder.glob(f"{name}-*.json"))
    results = {path: read_result(path) for path in paths}
    for path, result in results.items():
        if not is_of_row(result, run):
            log.warning(
                "%s: was trained or scored with other settings than the row is; it is left out.",
                path,
            )
    found = [result for result in results.values() if is_of_row(result, run)]
    if not found:
        return None
    longest = max(result.pictures for result in found)
    return together([result for result in found if result.pictures == longest])


def is_of_row(result: Result, run: RowRun) -> bool:
    """Whether it was trained and scored as the row is."""
    scored_on = (result.run, result.data, result.protocol, result.views)
    expected = (run.experiment.name, run.scored_on, run.protocol, run.views)
    return scored_on == expected and is_trained_as(result.experiment, run.experiment)


_OF_NO_ACCOUNT = {
    *("steps", "num_classes", "semantic_encoder", "val", "cache", "workers"),
    *("seed", "precision", "sync_batchnorm", "val_every", "checkpoint_every"),
    *("checkpoint_stages", "feature_cache"),
}
"""Settings of a row's run that may differ: length, of which it must have enough; what training
fills in; where an encoder's weights lie, as a result says which they were (`Result.weights`); what
is only watched; where and by whom pictures are read; the seed; how a device computes, and what it
keeps or computes again."""


def is_trained_as(recorded: dict[str, Any], experiment: Experiment) -> bool:
    """Whether recorded settings are those that decide what is learned, but for its length.

    Those that were not there yet when it was trained had what is their default now.
    """
    wanted, default = experiment.as_json(), _defaults(experiment)
    return all(
        recorded.get(part, {}).get(name, default[part].get(name)) == value
        for part in ("model", "data", "loss", "optimizer", "train")
        for name, value in wanted[part].items()
        if name not in _OF_NO_ACCOUNT
    )


def _defaults(experiment: Experiment) -> dict[str, Any]:
    """An experiment's settings, but for those that must be given, where nothing is said of them."""
    parts = ("model", "data", "loss", "optimizer", "train")
    plain = {part: type(getattr(experiment, part))() for part in parts}
    return replace(experiment, **plain).as_json()


def together(results: Sequence[Result]) -> Measured:
    """Mean and deviation of equally long trainings."""
    first = results[0]
    values = {name: [result.scores[name] for result in results] for name in METRICS}
    known = {name: scores for name, scores in values.items() if None not in scores}
    has_spread = len(results) > 1
    return Measured(
        seeds=tuple(result.seed for result in results),
        steps=first.steps,
        pictures=first.pictures,
        weights=" or ".join(dict.fromkeys(result.weights for result in results)),
        means={name: mean(known[name]) if name in known else None for name in METRICS},
        deviations={
            name: stdev(known[name]) if name in known and has_spread else None for name in METRICS
        },
    )
