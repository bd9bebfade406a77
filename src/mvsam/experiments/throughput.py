"""How fast a run trains: shown in the progress bar and logged beside the losses."""

import time
from collections import deque

from lightning import Callback, LightningModule, Trainer

from mvsam.memory import peak_memory
from mvsam.training.module import Batch

STEPS = 20
"""The latest steps, over which speed is a mean."""


class Throughput(Callback):
    """Samples a second, references a second among their views, and the peak of memory, GiB.

    All processes together; waiting for data counts, validation does not. Memory is that of the
    first process, on a GPU what tensors took.
    """

    def __init__(self):
        self._steps: deque[tuple[float, int, int]] = deque(maxlen=STEPS)
        self._last_end: float | None = None

    def on_train_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs,
        batch: Batch,
        batch_idx: int,
    ) -> None:
        now = time.perf_counter()
        if self._last_end is not None:
            samples = len(batch[0].images) * trainer.world_size
            self._steps.append((now - self._last_end, samples, samples * len(batch[1])))
        self._last_end = now
        if self._steps:
            seconds, samples, references = (
                sum(column) for column in zip(*self._steps, strict=True)
            )
            speed = {
                "train/samples_per_s": samples / seconds,
                "train/references_per_s": references / seconds,
                "train/peak_gib": peak_memory(pl_module.device.type) / 2**30,
            }
            pl_module.log_dict(speed, prog_bar=True)

    def on_validation_end(self, *_) -> None:
        self._last_end = None
