"""Frames of a scene kept in one uncompressed file, for data that is slow to make or to decode."""

import json
import zipfile
from functools import cache, partial
from pathlib import Path

import numpy as np

from mvsam.files import read_array, write_whole
from mvsam.geometry.depth_map import from_millimetres, to_millimetres
from mvsam.types import Frame, Scene


def cached_scene(scene: Scene, folder: Path) -> Scene:
    """The same scene read from `folder/NAME.npz`, which is written first where it is missing.

    Depth is kept in whole millimetres, so the first reading equals every later one.
    """
    path = folder / f"{scene.name.replace('/', '-')}.npz"
    if not path.exists():
        _write(scene, path)
    return CachedScene(path)


def _write(scene: Scene, path: Path) -> None:
    frames = [scene.frame(index) for index in range(len(scene))]
    arrays: dict[str, np.ndarray] = {
        "intrinsics": np.stack([frame.intrinsics for frame in frames]),
        "world_from_cam": np.stack([frame.world_from_cam for frame in frames]),
    }
    for index, frame in enumerate(frames):
        arrays[f"image{index}"] = frame.image
        if (depth := frame.depth) is not None:
            arrays[f"depth{index}"] = to_millimetres(depth)
        if (labels := frame.labels) is not None:
            arrays[f"labels{index}"] = labels
    about = {
        "name": scene.name,
        "frames": [(frame.name, frame.size) for frame in frames],
        "views": scene.views(),
    }
    arrays["about"] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
    write_whole(path, lambda file: np.savez(file, **arrays))  # pyright: ignore[reportArgumentType]


class CachedScene:
    """A scene in the file that `cached_scene` writes; reading a damaged one is an InputError."""

    def __init__(self, path: Path):
        self._read = cache(partial(read_array, path))
        self._about = json.loads(self._read("about").tobytes())
        with zipfile.ZipFile(path) as archive:
            self._keys = {Path(name).stem for name in archive.namelist()}

    @property
    def name(self) -> str:
        return self._about["name"]

    def __len__(self) -> int:
        return len(self._about["frames"])

    def frame(self, index: int) -> Frame:
        name, (width, height) = self._about["frames"][index]
        return Frame(
            name=name,
            size=(width, height),
            intrinsics=self._read("intrinsics")[index],
            world_from_cam=self._read("world_from_cam")[index],
            load_image=lambda: self._read(f"image{index}"),
            load_depth=self._depth(index) if f"depth{index}" in self._keys else None,
            load_labels=(
                (lambda: self._read(f"labels{index}")) if f"labels{index}" in self._keys else None
            ),
        )

    def views(self) -> list[tuple[int, ...]] | None:
        tuples = self._about["views"]
        return None if tuples is None else [tuple(views) for views in tuples]

    def _depth(self, index: int):
        return lambda: from_millimetres(self._read(f"depth{index}"))
