"""Data by name: `rooms:val`, a scene folder, a folder of scene folders, or a list of scenes."""

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from operator import getitem
from pathlib import Path
from typing import overload

from mvsam.data.cache import cached_scene
from mvsam.data.formats import Poses, find_format, open_scene
from mvsam.data.lazy import LazyScenes
from mvsam.data.readers.single_views import SingleViews, is_single_views
from mvsam.data.scaled import Baseline, parse_scale
from mvsam.data.splits import is_scene_list, listed_scenes
from mvsam.errors import InputError
from mvsam.types import Scene


def open_data(
    name: str,
    format: str | None = None,
    room_frames: int = 5,
    room_size: tuple[int, int] = (320, 256),
    cache: str | None = None,
    scale: float | str = 1.0,
    poses: Poses = "given",
    assets: str | None = None,
) -> "RoomScenes | LazyScenes | list[Scene]":
    """The scenes of `rooms:SPLIT`, `rooms:SPLIT:FIRST-END`, or a path.

    The end of a part is left out, as in Python's slices. A path is a scene, a folder of scene
    folders, which come sorted by name, or a list of scenes, as ScanNet's scannetv2_val.txt; all but
    the first of several are opened, and found broken, when they are asked for (`LazyScenes`). A
    folder of photos with depth or labels but without poses is a scene for each photo.
    `format` is that of every scene; none: found from its files.
    `room_frames` is the number of frames of each room, `room_size` their (width, height), `assets`
    the folder of an asset pack for them; they are rendered once where `cache` names a folder to
    keep them in (other data lie on a disk already). `scale` and `poses` as `open_scene`; a distance
    between two photos is that of one scene, and scenes without poses have no scale.
    """
    if is_rooms(name):
        if poses != "given":
            raise InputError(f"{name}: rooms have exact poses; leave --poses out.")
        if parse_scale(scale) != 1.0:
            raise InputError(f"{name}: rooms are in metres; leave --scale out.")
        return _open_rooms(name, RoomStyle(room_frames, room_size, cache, assets))
    if not name:
        raise InputError("the scene's path is empty; give a scene's folder, or . for this one.")
    path = Path(name)
    if is_scene_list(name) and not path.is_dir():
        folders = listed_scenes(path)
    elif poses != "colmap" and path.is_dir():
        folders = scene_folders(path) or [path]
    else:
        return [open_scene(path, format, scale, poses)]
    if len(folders) > 1 and isinstance(parse_scale(scale), Baseline):
        raise InputError(
            f"{name}: holds {len(folders)} scenes, but the distance of two photos is the scale of "
            "one; name the scene's own folder."
        )
    openers = [opener for folder in folders for opener in _openers(folder, format, scale, poses)]
    scenes = LazyScenes(openers)
    _ = scenes[0]  # what is wrong with a single one is said now
    return scenes


def is_rooms(name: str) -> bool:
    """Whether data are procedural rooms, not files."""
    return name.startswith("rooms:")


def _openers(
    folder: Path, format: str | None, scale: float | str, poses: Poses
) -> Sequence[Callable[[], Scene]]:
    """Of one scene, or of one for each photo of a folder without poses."""
    if format is not None or not is_single_views(folder):
        return [partial(open_scene, folder, format, scale, poses)]
    if parse_scale(scale) != 1.0:
        raise InputError(f"{folder}: has photos without poses; leave --scale out.")
    if poses == "refined":
        raise InputError(f"{folder}: has photos without poses; leave --poses refined out.")
    photos = SingleViews(folder)
    return [partial(getitem, photos, index) for index in range(len(photos))]


def scene_folders(path: Path) -> list[Path]:
    """The folders right below `path` that hold a scene, unless `path` is one itself."""
    if find_format(path):
        return []
    return [folder for folder in sorted(path.iterdir()) if folder.is_dir() and find_format(folder)]


@dataclass(frozen=True)
class RoomStyle:
    """What rooms have in common."""

    num_frames: int = 5
    size: tuple[int, int] = (320, 256)
    """(width, height) of the frames, pixels."""
    cache: str | None = None
    """Folder to keep rendered rooms in."""
    assets: str | None = None
    """Folder of an asset pack."""

    def cache_folder(self, version: int) -> Path | None:
        """Where the rooms of one version, size and pack lie."""
        if self.cache is None:
            return None
        pack = "" if self.assets is None else f"-{_name_of_pack(Path(self.assets))}"
        (width, height), frames = self.size, self.num_frames
        return Path(self.cache) / f"v{version}-{width}x{height}-{frames}frames{pack}"


def _name_of_pack(folder: Path) -> str:
    """Its folder's name, and a digest of what it lists: two packs may have the same name."""
    lists = [file.read_bytes() for file in sorted(folder.glob("*.csv"))]
    return f"{folder.resolve().name}-{hashlib.sha256(b''.join(lists)).hexdigest()[:8]}"


class RoomScenes(Sequence[Scene]):
    """Procedural rooms `first` .. `end` - 1 of a split, each built when it is asked for."""

    def __init__(self, split: str, first: int, end: int, style: RoomStyle):
        self.split, self.style = split, style
        self._indices = range(first, end)

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, position: int) -> Scene: ...

    @overload
    def __getitem__(self, position: slice) -> list[Scene]: ...

    def __getitem__(self, position: int | slice) -> Scene | list[Scene]:
        if isinstance(position, slice):
            return [self[index] for index in range(*position.indices(len(self)))]
        return _room(self.split, self._indices[position], self.style)


@lru_cache(maxsize=4)  # tuples of one room are usually read one after the other
def _room(split: str, index: int, style: RoomStyle) -> Scene:
    from mvsam import rooms  # needs the extra `rooms`, which reading folders does not

    scene = rooms.scene(split, index, style.num_frames, *style.size, assets=style.assets)
    folder = style.cache_folder(rooms.VERSION)
    return scene if folder is None else cached_scene(scene, folder)


def _open_rooms(name: str, style: RoomStyle) -> RoomScenes:
    from mvsam import rooms

    match = re.fullmatch(r"rooms:(\w+)(?::(\d+)-(\d+))?", name)
    if match is None or match[1] not in rooms.SPLITS:
        raise InputError(
            f"{name}: no such data; expected rooms:SPLIT or rooms:SPLIT:FIRST-END with one of "
            f"the splits {', '.join(rooms.SPLITS)}."
        )
    split, count = match[1], rooms.SPLITS[match[1]]
    if match[2] is None:
        if count is None:
            raise InputError(f"{name}: this split has no end; name a part, as {name}:0-100.")
        return RoomScenes(split, 0, count, style)
    first, end = int(match[2]), int(match[3])
    if first >= end:
        raise InputError(f"{name}: the part is empty; its end must be larger than its first.")
    if count is not None and end > count:
        raise InputError(f"{name}: this split has {count} scenes; end at {count} or before.")
    return RoomScenes(split, first, end, style)
