"""Recorded scans whose frames are kept, at the size they are trained at, in files of 32."""

import hashlib
from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from mvsam.data.cache import CachedScene, cached_scene
from mvsam.data.transforms import (
    Size,
    area_resize,
    crop_to_shape,
    resize_intrinsics,
    resize_nearest,
)
from mvsam.data.wrapped import WrappedScene
from mvsam.types import Frame, Scene

SHARD_FRAMES = 32


class ShardedScene(WrappedScene):
    """A scene resized to `size`; a shard is written when the first of its frames is asked for.

    A scan's photos are four times as large as what is trained on, and take longer to decode than to
    learn from. Frames that are in no view tuple are not kept. Colours are rounded to 8 bits and
    depth to millimetres, once; a shard that exists is never written again, so what is read does not
    depend on who wrote it.

    folder: of all shards; those of this scene lie in one named after it and its cameras.
    size: (width, height), pixels. crop: cut frames to the shape of `size` first.
    """

    def __init__(self, scene: Scene, folder: Path, size: Size, crop: bool = False):
        super().__init__(scene)
        self._folder, self._size, self._crop = folder, size, crop

    def frame(self, index: int) -> Frame:
        frame = self._resized(index)
        return replace(
            frame,
            load_image=lambda: self._kept(index).image,
            load_depth=(lambda: self._kept(index).depth) if frame.load_depth else None,
            load_labels=(lambda: self._kept(index).labels) if frame.load_labels else None,
        )

    def _resized(self, index: int) -> Frame:
        """The frame as it goes into a shard."""
        frame = self._scene.frame(index)
        return resized(crop_to_shape(frame, self._size) if self._crop else frame, self._size)

    def _kept(self, index: int) -> Frame:
        shard, place = divmod(self._places[index], SHARD_FRAMES)
        path = self._own_folder / f"{shard:04d}.npz"
        if not path.exists():
            used = self._used[shard * SHARD_FRAMES : (shard + 1) * SHARD_FRAMES]
            cached_scene(_Part(path.stem, [self._resized(i) for i in used]), path.parent)
        return _opened(path).frame(place)

    @cached_property
    def _used(self) -> list[int]:
        """The frames that are in a view tuple."""
        tuples = self.views()
        return (
            list(range(len(self)))
            if tuples is None
            else sorted({index for views in tuples for index in views})
        )

    @cached_property
    def _places(self) -> dict[int, int]:
        return {index: place for place, index in enumerate(self._used)}

    @cached_property
    def _own_folder(self) -> Path:
        digest = hashlib.sha256(repr((self._size, self._crop, self._used)).encode())
        for index in self._used:
            frame = self._scene.frame(index)
            maps = frame.load_depth is not None, frame.load_labels is not None
            digest.update(repr((frame.name, frame.size, maps)).encode())
            digest.update(frame.intrinsics.tobytes() + frame.world_from_cam.tobytes())
        return self._folder / f"{self.name.replace('/', '-')}-{digest.hexdigest()[:12]}"


def resized(frame: Frame, size: Size) -> Frame:
    """The whole frame stretched to `size`, in 8-bit colours."""
    if frame.size == size:
        return frame
    depth, labels = frame.load_depth, frame.load_labels

    def image() -> np.ndarray:
        values = area_resize(frame.image, size).permute(1, 2, 0)
        return (values * 255).round().byte().numpy()

    return replace(
        frame,
        size=size,
        intrinsics=resize_intrinsics(frame.intrinsics, frame.size, size),
        load_image=image,
        load_depth=(lambda: resize_nearest(depth(), size)) if depth else None,
        load_labels=(lambda: resize_nearest(labels(), size)) if labels else None,
    )


@lru_cache(maxsize=8)  # their arrays stay in memory once read, about 16 MB a shard at 320x256
def _opened(shard: Path) -> CachedScene:
    return CachedScene(shard)


class _Part:
    """Some frames as a scene of their own, for `cached_scene`."""

    def __init__(self, name: str, frames: list[Frame]):
        self.name, self._frames = name, frames

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> Frame:
        return self._frames[index]

    def views(self) -> None:
        return None
