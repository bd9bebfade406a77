"""Labelled single pictures, as NYUv2's: a posed folder without poses, each photo its own scene.

They serve what looks at one picture: labels, and measured depth as the prompt.
"""

import logging
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import overload

import numpy as np

from mvsam.data.files import check_photo, load_depth, load_labels, load_photo
from mvsam.data.readers.listed import ListedScene
from mvsam.data.readers.posed_folder import list_maps, list_photos, read_classes, read_intrinsics
from mvsam.errors import InputError, counted
from mvsam.types import Frame, Scene

log = logging.getLogger("mvsam")
_POSES = ("poses", "pose", "transforms.json", "sparse", "colmap", "cameras.txt", "cameras.bin")


def is_single_views(path: Path) -> bool:
    """Whether photos with labels or depth lie there, and nothing that could hold poses."""
    has_maps = (path / "labels").is_dir() or (path / "depth").is_dir()
    has_poses = any((path / name).exists() for name in _POSES)
    return (path / "color").is_dir() and has_maps and not has_poses


class SingleViews(Sequence[Scene]):
    """One scene of one frame for each photo; the pose is the identity and means nothing.

    without: names that are left out; only: if given, all others are.
    Raises `InputError` as a posed folder does.
    """

    def __init__(self, path: Path, without: Sequence[str] = (), only: Sequence[str] | None = None):
        self.name, self.classes = path.resolve().name, read_classes(path)
        self._photos = list_photos(path)
        wanted = {*self._photos} - {*without}
        wanted = wanted if only is None else wanted & {*only}
        self._chosen = [name for name in self._photos if name in wanted]
        if not self._chosen:
            raise InputError(f"{path}: every photo is left out; leave fewer out.")
        self._sizes = {name: check_photo(file) for name, file in self._photos.items()}
        self._intrinsics = read_intrinsics(path, self._sizes)
        self._depth = list_maps(path, "depth", self._sizes)
        self._labels = list_maps(path, "label", self._sizes)
        log.info("%s: has no poses/; %s taken alone.", path, counted(len(self._chosen), "photo"))

    def __len__(self) -> int:
        return len(self._chosen)

    @overload
    def __getitem__(self, position: int) -> Scene: ...

    @overload
    def __getitem__(self, position: slice) -> list[Scene]: ...

    def __getitem__(self, position: int | slice) -> Scene | list[Scene]:
        if isinstance(position, slice):
            return [self._scene(name) for name in self._chosen[position]]
        return self._scene(self._chosen[position])

    def _scene(self, name: str) -> ListedScene:
        depth, labels = self._depth.get(name), self._labels.get(name)
        frame = Frame(
            name=name,
            size=self._sizes[name],
            intrinsics=self._intrinsics[name],
            world_from_cam=np.eye(4),
            load_image=partial(load_photo, self._photos[name]),
            load_depth=partial(load_depth, depth) if depth else None,
            load_labels=partial(load_labels, labels, len(self.classes)) if labels else None,
        )
        return ListedScene(f"{self.name}/{name}", [frame], classes=self.classes, has_poses=False)
