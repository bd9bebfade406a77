"""A run of seconds through the real driver, here or in a process of its own.

python -m tests.experiments.small_run FOLDER DATA [--devices N] [--kill-at STEP] [--gradients VAL]
"""

import argparse
import os
import signal
from dataclasses import replace
from pathlib import Path
from unittest import mock

import torch
from torch.nn.modules.batchnorm import _BatchNorm

from mvsam.data.streaming.config import DataConfig
from mvsam.experiments.config import Experiment, ModelConfig
from mvsam.experiments.driver import train
from mvsam.training.module import TrainConfig, TrainingModule
from mvsam.training.optim import OptimizerConfig
from tests.small import SIDE


def small_experiment(data: Path, steps: int, precision: str) -> Experiment:
    """`tiny` on 64 x 64 pixels, a checkpoint every second step, a validation in the middle."""
    return Experiment(
        name="small",
        about="A test.",
        model=ModelConfig("tiny"),
        data=DataConfig(train=str(data), val=str(data), references=2, size=(SIDE, SIDE), workers=0),
        optimizer=OptimizerConfig(steps=steps),
        train=TrainConfig(batch_size=2, precision=precision, val_every=3, checkpoint_every=2),
    )


def with_singles(data: Path, steps: int) -> Experiment:
    """The folder's photos once as tuples and once as if nobody knew their poses."""
    experiment = small_experiment(data, steps, "auto")
    settings = replace(experiment.data, singles=str(data), singles_per_sample=2)
    return replace(experiment, data=settings)


def run(folder: Path, data: Path, steps: int = 6, devices: int = 1, precision="auto") -> Path:
    """Trains to the end, or goes on where a killed run stopped."""
    return drive(small_experiment(data, steps, precision), folder, devices)


def drive(experiment: Experiment, folder: Path, devices: int) -> Path:
    """The real driver on the small model."""
    with mock.patch("mvsam.assemblies.tiny.TINY_SIDE", SIDE):
        return train(experiment, folder, devices, accelerator="cpu", progress=False)


def killed_at(step: int):
    """A patch under which the process dies right after this optimiser step."""

    def end_of_step(module: TrainingModule, *_) -> None:
        if module.trainer.global_step == step:
            os.kill(os.getpid(), signal.SIGKILL)

    return mock.patch.object(TrainingModule, "on_train_batch_end", end_of_step)


def gradients_of_one_step(folder: Path, data: Path, val: Path, devices: int) -> None:
    """Writes each process's gradients just before the optimiser uses them; scores it on `val`.

    The learning rate is 0, so that the scores are those of the first weights.
    """

    def write(module: TrainingModule, optimizer) -> None:
        gradients = {n: p.grad.clone() for n, p in module.named_parameters() if p.grad is not None}
        torch.save(gradients, folder / f"gradients{module.global_rank}.pt")

    def keep_statistics(module: TrainingModule, *_) -> None:
        """Half a batch has other means and variances than a whole one."""
        for part in module.modules():
            if isinstance(part, _BatchNorm):
                part.eval()

    folder.mkdir(exist_ok=True)
    with (
        mock.patch.object(TrainingModule, "on_before_optimizer_step", write),
        mock.patch.object(TrainingModule, "on_train_batch_start", keep_statistics),
    ):
        experiment = small_experiment(data, 1, "32-true")
        experiment = replace(
            experiment,
            data=replace(experiment.data, val=str(val)),
            optimizer=replace(experiment.optimizer, lr=0.0),
            train=replace(experiment.train, val_every=1),
        )
        drive(experiment, folder, devices)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("data", type=Path)
    parser.add_argument("--devices", type=int, default=1)
    parser.add_argument("--kill-at", type=int)
    parser.add_argument("--gradients", type=Path, metavar="VAL")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.gradients:
        gradients_of_one_step(
            arguments.folder, arguments.data, arguments.gradients, arguments.devices
        )
    else:
        with killed_at(arguments.kill_at):
            run(arguments.folder, arguments.data)


if __name__ == "__main__":
    main()
