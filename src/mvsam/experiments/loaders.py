"""What a run reads: the sample stream from where it stopped, and its share of validation scenes."""

import os
import signal
from math import ceil

from lightning import LightningDataModule
from torch.utils.data import DataLoader

from mvsam.data.catalog import is_rooms, open_data
from mvsam.data.dataset import TupleDataset, collate
from mvsam.data.streaming.stream import Onward, SampleStream, collate_training
from mvsam.data.view_rules import RULES, prescribe
from mvsam.experiments.config import Experiment


def num_workers(wanted: int | None, processes: int) -> int:
    """`DataConfig.workers` of each of so many training processes on this machine."""
    if wanted is not None:
        return wanted
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return min(max(cores // processes - 1, 1), 15)


class ExperimentData(LightningDataModule):
    """The sample stream, begun where a resumed run stopped, and one tuple a validation scene."""

    def __init__(self, experiment: Experiment, num_processes: int):
        super().__init__()
        self.experiment = experiment
        self.num_processes = num_processes
        self.next_sample = 0

    def train_dataloader(self) -> DataLoader:
        data, train = self.experiment.data, self.experiment.train
        assert self.trainer is not None
        share = train.batch_size // self.num_processes
        workers = num_workers(data.workers, self.trainer.num_devices)
        return DataLoader(
            SampleStream(data, train.seed, train.batch_size),
            batch_size=share,
            sampler=Onward(self.next_sample + self.trainer.global_rank, self.num_processes),
            num_workers=workers,
            collate_fn=collate_training,
            prefetch_factor=4 if workers else None,
            multiprocessing_context="spawn" if workers else None,
            worker_init_fn=_leave_ctrl_c_to_the_trainer if workers else None,
        )

    def val_dataloader(self) -> DataLoader:
        data = self.experiment.data
        assert self.trainer is not None
        scenes = open_data(data.val, cache=data.cache, **data.of_scans(data.val))
        if data.tuples in RULES and not is_rooms(data.val):
            scenes = prescribe(scenes, data.tuples, data.num_views, data.depth_range)
        share = share_of_scenes(len(scenes), self.trainer.global_rank, self.num_processes)
        tuples = TupleDataset(
            [scenes[index] for index in share],
            data.num_views,
            data.size,
            data.depth_range,
            tuples_per_scene=1,
            semantic_size=data.semantic_size,
            crop=data.crop,
        )
        return DataLoader(tuples, batch_size=1, collate_fn=collate)

    def state_dict(self) -> dict:
        assert self.trainer is not None
        return {"next_sample": self.trainer.global_step * self.experiment.train.batch_size}

    def load_state_dict(self, state_dict: dict) -> None:
        self.next_sample = state_dict["next_sample"]


def share_of_scenes(count: int, process: int, num_processes: int) -> list[int]:
    """Which of `count` scenes one process looks at; together all of them.

    Every process gets equally many, because each forward pass of one waits for the others; so
    some of the first scenes come twice, and count once (`TrainingModule.on_validation_epoch_end`).
    """
    each = ceil(count / num_processes)
    return [(process + turn * num_processes) % count for turn in range(each)]


def _leave_ctrl_c_to_the_trainer(worker: int) -> None:
    """A terminal sends Ctrl-C to every process; the step that is to be finished needs its data."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
