"""`mvsam train`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mvsam.errors import MissingExtraError

if TYPE_CHECKING:
    from mvsam.experiments.config import Experiment

HELP_FLAGS = ("-h", "--help")


@dataclass(frozen=True)
class Train:
    """Trains a run, or goes on with it where it stopped.

    Every setting of the run can be changed, as --optimizer.lr 3e-4;
    mvsam train RUN --help lists them with their values in that run.

    Example: mvsam train tiny --out runs/mine --optimizer.steps 500

    On your own scenes: mvsam train tiny --data my_scenes --init tiny --out runs/my_scenes
    """

    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")]
    """Name of a run."""
    data: str | None = None
    """Scenes to train on, as --data.train; your own folder, say."""
    init: str | None = None
    """Weights to begin with, as --model.init; tiny, say."""
    out: Path | None = None
    """Folder for checkpoints, logs and weights; runs/RUN where it is not given."""
    devices: int = 1
    """Processes on this machine, one a GPU."""
    nodes: int = 1
    """Machines; start the same command on each."""
    accelerator: Literal["auto", "cpu", "gpu"] = "auto"
    """What to train on; auto takes GPUs where there are some."""
    overrides: tyro.conf.Suppress[tuple[str, ...]] = ()

    @staticmethod
    def parse(arguments: Sequence[str]) -> Train:
        """Reads the verb's own options and keeps the others for the run's settings."""
        # Help that follows a name is about that run, not about the verb.
        is_about_run = bool(arguments) and not arguments[0].startswith("-")
        asked = [a for a in arguments if is_about_run and a in HELP_FLAGS]
        verb, others = tyro.cli(
            Train,
            prog="mvsam train",
            args=[a for a in arguments if a not in asked],
            return_unknown_args=True,
        )
        return replace(verb, overrides=(*others, *asked))

    def run(self) -> None:
        try:
            from mvsam.experiments.driver import train
        except ModuleNotFoundError as error:
            raise MissingExtraError("training", error.name or "lightning", "train") from error
        from mvsam.experiments.config import Experiment
        from mvsam.experiments.runs import find_run

        experiment = tyro.cli(
            Experiment,
            prog=f"mvsam train {self.name}",
            default=self._with_shortcuts(find_run(self.name)),
            args=list(self.overrides),
        )
        folder = self.out or Path("runs") / self.name
        steps, samples = experiment.optimizer.steps, experiment.train.batch_size
        print(f"Run {experiment.name} into {folder}: {steps:,} steps of {samples} samples")
        weights = train(
            experiment,
            folder,
            self.devices,
            self.nodes,
            self.accelerator,
        )
        print(f"Weights: {weights}")

    def _with_shortcuts(self, experiment: Experiment) -> Experiment:
        """The run with --data and --init in the places that have longer names."""
        data, model = experiment.data, experiment.model
        if self.data:
            data = replace(data, train=self.data)
        if self.init:
            model = replace(model, init=(self.init,))
        return replace(experiment, data=data, model=model)
