"""Results of rows that nobody trained."""

from pathlib import Path

from mvsam.experiments.results import Result, write_result
from mvsam.experiments.rows import RowRun


def result_of(run: RowRun, seed: int = 0, pictures: int = 4800, **scores: float) -> Result:
    """Metres and fractions; a score that is not given is that of an absent task."""
    return Result(
        run=run.experiment.name,
        seed=seed,
        data=run.scored_on,
        protocol=run.protocol,
        views=run.views,
        steps=pictures // 12,
        pictures=pictures,
        weights="random",
        scores={name: scores.get(name) for name in ("abs", "rel", "rmse", "miou")},
        experiment=run.experiment.as_json(),
    )


def write_seeds(folder: Path, run: RowRun, pictures: int = 4800, **scores: list[float]) -> None:
    """One result a seed, with its place in each list of scores."""
    count = len(next(iter(scores.values())))
    for seed in range(count):
        own = {name: values[seed] for name, values in scores.items()}
        write_result(folder, result_of(run, seed, pictures, **own), "cpu")
