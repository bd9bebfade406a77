"""Seconds inside the parts of a model, and of whole calls."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from statistics import median

import torch
from torch import nn


class StageClock:
    """Adds up the seconds inside named stages; on a GPU it waits for the work to end."""

    def __init__(self, device: str):
        self.device = device
        self.seconds: defaultdict[str, float] = defaultdict(float)

    def now(self) -> float:
        if self.device == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Counts what runs inside."""
        start = self.now()
        yield
        self.seconds[name] += self.now() - start

    def watch(self, model: nn.Module, paths: Sequence[str]) -> None:
        """Counts the forward pass of each of these submodules that the model has."""
        modules = dict(model.named_modules())
        for path in paths:
            if path in modules:
                started: list[float] = []
                modules[path].register_forward_pre_hook(
                    lambda *_, started=started: started.append(self.now())
                )
                modules[path].register_forward_hook(
                    lambda *_, started=started, path=path: self._stop(path, started)
                )

    def _stop(self, path: str, started: list[float]) -> None:
        self.seconds[path] += self.now() - started.pop()

    def median_seconds(self, call: Callable[[], object], repeats: int) -> float:
        """Of so many calls."""
        seconds = []
        for _ in range(repeats):
            start = self.now()
            call()
            seconds.append(self.now() - start)
        return median(seconds)
