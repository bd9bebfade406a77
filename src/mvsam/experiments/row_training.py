"""One row of the tables, trained and scored: what is done is not done again."""

import fcntl
import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from mvsam.convolution import fold_batch_norm
from mvsam.data.catalog import open_data
from mvsam.data.dataset import TupleDataset
from mvsam.device import find_device
from mvsam.errors import InputError
from mvsam.evaluation.evaluate import evaluate
from mvsam.evaluation.protocols import PROTOCOLS
from mvsam.experiments.config import Experiment, ModelConfig
from mvsam.experiments.driver import LAST, WEIGHTS, train
from mvsam.experiments.results import (
    Result,
    is_of_row,
    is_trained_as,
    read_result,
    result_path,
    write_result,
)
from mvsam.experiments.rows import RowRun, pictures_of
from mvsam.experiments.runs import RUNS
from mvsam.weights import RUN_PAGE, load, read_info

Progress = Callable[[int, int], None]
"""Called with the number of photos scored so far, and of all."""


@dataclass(frozen=True)
class Folders:
    """Where rows are kept."""

    runs: Path = Path("runs")
    """A folder of checkpoints and weights for each seed of a row."""
    results: Path = Path("results/runs")
    """A JSON file for each."""

    def weights(self, run: RowRun, seed: int) -> Path:
        """What training the row with that seed leaves."""
        return self.runs / f"{run.experiment.name}-{seed}" / WEIGHTS


@dataclass(frozen=True)
class Job:
    """One seed of one row."""

    run: RowRun
    seed: int
    steps: int
    accelerator: str = "auto"
    needs_weights: bool = False
    """Done only while its weights are there, as they are shown."""

    @property
    def name(self) -> str:
        return f"{self.run.experiment.name}-{self.seed}"

    @property
    def experiment(self) -> Experiment:
        whole = self.run.experiment
        return replace(
            whole,
            optimizer=replace(whole.optimizer, steps=self.steps),
            train=replace(whole.train, seed=self.seed),
        )


def jobs_of(
    rows: Sequence[str],
    runs: dict[str, RowRun],
    steps: int | None = None,
    seeds: int | None = None,
    accelerator: str = "auto",
    needs_weights: bool = False,
) -> list[Job]:
    """The trainings that these rows ask for, each once and after those it begins with.

    steps, seeds: the same for every row, as on a GPU; None: each row's own. A row that another
    begins with is needed with its first seed alone. needs_weights: as of `Job`, for every row.
    """
    jobs: dict[str, Job] = {}
    for run in (runs[name] for name in rows):
        needed = [(run, seed) for seed in (range(seeds) if seeds else run.seeds)]
        if run.row.after:
            needed.insert(0, (runs[run.row.after], 0))
        for each, seed in needed:
            length = steps or each.experiment.optimizer.steps
            job = Job(each, seed, length, accelerator, needs_weights)
            jobs.setdefault(job.name, job)
    return list(jobs.values())


def is_left(job: Job, jobs: Sequence[Job], folders: Folders) -> bool:
    """Whether it is to be done: it is not, or its weights are gone with which others begin."""
    if not is_done(job, folders):
        return True
    name, is_first = job.run.row.name, job.seed == 0
    waiting = [j for j in jobs if is_first and j.run.row.after == name and not is_done(j, folders)]
    return bool(waiting) and not folders.weights(job.run, job.seed).exists()


def is_done(job: Job, folders: Folders) -> bool:
    """Whether there is a result of so many steps, or more, that was made as the row is now."""
    path = result_path(folders.results, job.run.experiment.name, job.seed)
    if not path.exists() or (job.needs_weights and not folders.weights(job.run, job.seed).exists()):
        return False
    result = read_result(path)
    return result.steps >= job.steps and is_of_row(result, job.run)


@contextmanager
def claim(job: Job, folders: Folders) -> Iterator[bool]:
    """True inside where no other process of this machine is at the job; a killed one lets go."""
    folders.runs.mkdir(parents=True, exist_ok=True)
    with (folders.runs / f".{job.name}.claimed").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        yield True


def train_and_score(
    job: Job, folders: Folders, progress: Progress | None = None, shows_training: bool = True
) -> Path:
    """Trains a row with one seed, or goes on with it, then scores it; returns the result's path."""
    check_beginning(job.experiment.model)
    weights, seconds = folders.weights(job.run, job.seed), None
    folder = weights.parent
    _check_leftover(folder / RUN_PAGE, job)
    if not _is_trained(weights, job.steps):
        was_begun, start = (folder / LAST).exists(), time.perf_counter()
        train(job.experiment, folder, accelerator=job.accelerator, progress=shows_training)
        seconds = None if was_begun else time.perf_counter() - start
        (folder / LAST).unlink(missing_ok=True)  # three times the weights, and never needed again
    scores = score(weights, job, progress)
    device = find_device(job.accelerator, "--accelerator")
    return write_result(folders.results, _result(job, weights, scores, seconds), device)


def train_jobs(
    jobs: Sequence[Job], folders: Folders, announce: Callable[[str], None], progress: Progress
) -> list[Job]:
    """Does what is left of the jobs, in their order; returns those that another process is at."""
    elsewhere: list[Job] = []
    for number, job in enumerate(jobs, start=1):
        place = f"{number} of {len(jobs)}: {job.name}"
        if not is_left(job, jobs, folders):
            announce(f"{place} is done")
            continue
        with claim(job, folders) as is_ours:
            begins_with = job.run.row.after
            if not is_ours or begins_with in {other.run.row.name for other in elsewhere}:
                announce(f"{place} is left to another process")
                elsewhere.append(job)
                continue
            announce(f"{place}, {job.steps} steps")
            train_and_score(job, folders, progress)
    return elsewhere


def check_beginning(config: ModelConfig) -> None:
    """InputError where weights that the model begins with are still to be made or fetched."""
    for path in config.beginnings:
        if Path(path).suffix not in (".safetensors", ".pth") or Path(path).exists():
            continue
        run = Path(path).parent.name
        if path.endswith(".pth"):
            remedy = "fetch it from the segment-anything project's page"
        elif run in RUNS:
            remedy = f"`mvsam train {run}` makes it"
        else:
            budget = run.rsplit("_", 1)[-1].partition("-")[0]
            remedy = f"`mvsam table 4 --data {budget} --train` makes it"
        raise InputError(f"{path} is missing, which {config.name} begins with: {remedy}.")


def _check_leftover(page: Path, job: Job) -> None:
    """InputError where the folder holds the row as it was trained when it was another."""
    if page.exists() and not is_trained_as(json.loads(page.read_text()), job.experiment):
        raise InputError(
            f"{page.parent} was trained with other settings than the row "
            f"{job.run.row.name} is now: remove or rename that folder, and it is trained anew."
        )


def _is_trained(weights: Path, steps: int) -> bool:
    page = weights.with_suffix(".json")
    if not (weights.exists() and page.exists()):
        return False
    return read_info(page).training.get("steps", 0) >= steps


def score(weights: Path, job: Job, progress: Progress | None = None) -> dict:
    """Scores of a row's weights, as `mvsam eval` gives them, without the single scenes."""
    run, protocol = job.run, PROTOCOLS[job.run.protocol]
    device = find_device(job.accelerator, "--accelerator")
    model = load(str(weights)).to(device)
    samples = TupleDataset(
        open_data(run.scored_on, cache=run.experiment.data.cache),
        run.views,
        protocol.size,
        protocol.search_range or protocol.depth_range,
        protocol.tuples_per_scene,
        model.semantic_size,
        truth_size=protocol.truth_size,
    )
    count = len(samples)
    scores = evaluate(
        fold_batch_norm(model),
        (samples[index] for index in range(count)),
        protocol,
        (lambda done: progress(done, count)) if progress else None,
        precision="auto",
    ).as_json()
    return {name: value for name, value in scores.items() if name != "scenes"}


def _result(job: Job, weights: Path, scores: dict, seconds: float | None) -> Result:
    run, training = job.run, read_info(weights.with_suffix(".json")).training
    page = json.loads((weights.parent / RUN_PAGE).read_text())
    return Result(
        run=run.experiment.name,
        seed=job.seed,
        data=run.scored_on,
        protocol=run.protocol,
        views=run.views,
        steps=training["steps"],
        pictures=pictures_of(job.experiment, training["steps"]),
        weights=training.get("began_with", "not recorded"),
        scores=scores,
        train_seconds=seconds,
        trained_at=training.get("commit"),
        experiment={name: page[name] for name in job.experiment.as_json()},
    )
