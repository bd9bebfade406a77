"""Seconds inside the parts of a model, and of whole calls."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from statistics import median
from time import perf_counter
from typing import Any

import torch
from torch import nn


class StageClock:
    """Adds up the seconds inside named stages.

    On a GPU they are those of the GPU, by events in its stream, so that nothing has to wait.
    """

    def __init__(self, device: str):
        self.device = device
        self._stages: defaultdict[str, list[tuple[Any, Any]]] = defaultdict(list)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Counts what runs inside."""
        start = self._mark()
        yield
        self._stages[name].append((start, self._mark()))

    def watch(self, model: nn.Module, paths: Sequence[str]) -> None:
        """Counts the forward pass of each of these submodules that the model has."""
        modules = dict(model.named_modules())
        for path in paths:
            if path in modules:
                starts: list[Any] = []
                modules[path].register_forward_pre_hook(
                    lambda *_, starts=starts: starts.append(self._mark())
                )
                modules[path].register_forward_hook(
                    lambda *_, starts=starts, path=path: self._stages[path].append(
                        (starts.pop(), self._mark())
                    )
                )

    def seconds(self) -> dict[str, float]:
        """Inside each stage since the clock was made or cleared."""
        self._wait()
        return {
            name: sum(self._between(*interval) for interval in intervals)
            for name, intervals in self._stages.items()
        }

    def clear(self) -> None:
        """Forgets what was counted."""
        self._stages.clear()

    def median_seconds(self, call: Callable[[], object], repeats: int) -> float:
        """Of so many calls, each to its very end."""
        seconds = []
        for _ in range(repeats):
            self._wait()
            start = perf_counter()
            call()
            self._wait()
            seconds.append(perf_counter() - start)
        return median(seconds)

    def _wait(self) -> None:
        if self.device == "cuda":
            torch.cuda.synchronize()

    def _mark(self) -> Any:
        if self.device != "cuda":
            return perf_counter()
        event = torch.cuda.Event(enable_timing=True)
        event.record()
        return event

    def _between(self, start: Any, end: Any) -> float:
        return start.elapsed_time(end) / 1000 if self.device == "cuda" else end - start
