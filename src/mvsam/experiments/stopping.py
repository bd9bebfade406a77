"""A run that ends early goes on where it was: Ctrl-C waits for the step, every end is saved."""

import logging
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.utilities.exceptions import SIGTERMException

log = logging.getLogger("mvsam")


class SafeStop(Callback):
    """Writes the checkpoint `path` when training ends early, by Ctrl-C, a signal or an error.

    Inside `listening` the first Ctrl-C lets the step finish, so that resuming is exact; a second
    one stops at once. After an error in the middle of a step batch norm may have seen its samples.
    The last regular checkpoint stays where a new one would be worse: no step was taken, the
    optimiser was at work, a weight is not finite, or one process of several fell out of step.
    """

    def __init__(self, path: Path):
        self.path = path
        self.is_asked = False
        self._is_agreed = False
        self._is_changing_weights = False
        self._first_step: int | None = None

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Inside, Ctrl-C is a request. (Python hears signals in its main thread alone.)"""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = signal.signal(signal.SIGINT, self._ask)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)

    def _ask(self, *_) -> None:
        if self.is_asked:
            raise KeyboardInterrupt
        self.is_asked = True
        log.info("stops after this step; Ctrl-C again stops at once.")

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        self._first_step = trainer.global_step

    def on_before_optimizer_step(self, *_) -> None:
        self._is_changing_weights = True

    def on_train_batch_end(self, trainer: Trainer, *_) -> None:
        self._is_changing_weights = False
        # Ctrl-C may reach the processes in different steps; they stop in the same one.
        if trainer.strategy.reduce_boolean_decision(self.is_asked, all=False):
            self._is_agreed = True
            raise KeyboardInterrupt

    def on_exception(
        self, trainer: Trainer, pl_module: LightningModule, exception: BaseException
    ) -> None:
        step = trainer.global_step
        if self._first_step is None or step == self._first_step:
            return
        is_whole = not self._is_changing_weights and _is_finite(pl_module)
        if not is_whole or (trainer.world_size > 1 and not self._is_agreed):
            log.warning("step %d is not saved; %s stays as it was.", step, self.path)
            return
        try:
            trainer.save_checkpoint(self.path, weights_only=False)
        except Exception as error:  # what ended the run is what the user has to hear of
            log.warning("step %d could not be saved: %s", step, error)
            return
        if trainer.is_global_zero:
            log.info("%s holds step %d; the same command goes on from there.", self.path, step)


@contextmanager
def early_end(stop: SafeStop) -> Iterator[None]:
    """Lets `stop` hear Ctrl-C, and ends as Python does: Lightning makes a SystemExit of it."""
    try:
        with stop.listening():
            yield
    except SIGTERMException as error:
        raise SystemExit(128 + signal.SIGTERM) from error
    except (SystemExit, RuntimeError) as error:
        if not stop.is_asked:
            raise
        # A RuntimeError: Ctrl-C ended a data worker that was just starting.
        raise KeyboardInterrupt from error


def _is_finite(module: LightningModule) -> bool:
    values = (value for value in module.state_dict().values() if value.is_floating_point())
    return all(bool(torch.isfinite(value).all()) for value in values)
