"""Photos are read and resized on a thread of their own while the network is at work."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from mvsam.types import Frame, Views

Item = TypeVar("Item")


def one_ahead(items: Iterable[Item]) -> Iterator[Item]:
    """The same items; each is made on a thread of its own while the one before it is in use."""
    end = object()
    source = iter(items)
    with ThreadPoolExecutor(1, "mvsam-reader") as thread:
        coming = thread.submit(next, source, end)
        while (item := coming.result()) is not end:
            coming = thread.submit(next, source, end)
            yield item  # pyright: ignore[reportReturnType]


class PhotoReader:
    """Reads a photo when it is asked for, or before, when it was announced.

    It holds the announced photos and no others, so whoever announces sets the bound. A photo that
    cannot be read raises its error where it is taken. Frames are told apart by name.
    """

    def __init__(self, read: Callable[[Frame], Views]):
        self._read = read
        self._thread = ThreadPoolExecutor(1, "mvsam-reader")
        self._announced: dict[str, Future[Views]] = {}

    def announce(self, frames: Iterable[Frame]) -> None:
        """Begins to read these photos, in this order."""
        for frame in frames:
            if frame.name not in self._announced:
                self._announced[frame.name] = self._thread.submit(self._read, frame)

    def take(self, frame: Frame) -> Views:
        """The photo; read here and now where it was not announced."""
        reading = self._announced.pop(frame.name, None)
        return self._read(frame) if reading is None else reading.result()

    def close(self) -> None:
        """Forgets what was announced; waits for the one photo that is being read."""
        self._announced.clear()
        self._thread.shutdown(cancel_futures=True)
