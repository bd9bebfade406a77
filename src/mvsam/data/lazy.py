"""Many scenes of which few are open: a whole ScanNet would fill the memory with poses."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import overload

from mvsam.types import Scene

MOST_OPEN = 256
"""Scenes; a ScanNet scan has about 4 MB of poses and file places, and opens in 0.4 s."""


class LazyScenes(Sequence):  # not Sequence[Scene], for which runtime type checks open some
    """Scenes that are opened when they are asked for, of which the last used stay open."""

    def __init__(self, openers: Sequence[Callable[[], Scene]]):
        self._openers = openers
        self._open: dict[int, Scene] = {}
        """Longest unused first."""

    def __len__(self) -> int:
        return len(self._openers)

    def __iter__(self) -> Iterator[Scene]:
        return (self[index] for index in range(len(self)))

    @overload
    def __getitem__(self, position: int) -> Scene: ...

    @overload
    def __getitem__(self, position: slice) -> "LazyScenes": ...

    def __getitem__(self, position: int | slice) -> "Scene | LazyScenes":
        if isinstance(position, slice):
            return LazyScenes(self._openers[position])
        index = range(len(self))[position]
        scene = self._open.pop(index, None) or self._openers[index]()
        self._open[index] = scene
        if len(self._open) > MOST_OPEN:
            del self._open[next(iter(self._open))]
        return scene


def changed(scenes: Sequence[Scene], change: Callable[[Scene], Scene]) -> LazyScenes:
    """The same scenes, each through `change` when it is asked for."""
    return LazyScenes([partial(_changed, scenes, i, change) for i in range(len(scenes))])


def _changed(scenes: Sequence[Scene], index: int, change: Callable[[Scene], Scene]) -> Scene:
    return change(scenes[index])
