"""Data by name: `rooms:val`, a scene folder, a folder of scene folders, or a list of scenes."""

import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from mvsam.data.cache import cached_scene
from mvsam.data.formats import Poses, find_format, open_scene
from mvsam.data.readers.single_views import SingleViews, is_single_views
from mvsam.data.splits import is_scene_list, listed_scenes
from mvsam.errors import InputError
from mvsam.types import Scene


def open_data(
    name: str,
    format: str | None = None,
    room_frames: int = 5,
    room_size: tuple[int, int] = (320, 256),
    cache: str | None = None,
    scale: float = 1.0,
    poses: Poses = "given",
) -> Sequence[Scene]:
    """The scenes of `rooms:SPLIT`, `rooms:SPLIT:FIRST-END`, or a path.

    The end of a part is left out, as in Python's slices. A path is a scene, a folder of scene
    folders, which come sorted by name, or a list of scenes, as ScanNet's scannetv2_val.txt. A
    folder of photos with depth or labels but without poses is a scene for each photo.
    `room_frames` is the number of frames of each room, `room_size` their (width, height); rooms
    are rendered once where `cache` names a folder to keep them in (other data lie on a disk
    already). `scale` is how many metres one unit of a path's poses has; `poses` as `open_scene`.
    """
    if name.startswith("rooms:"):
        return _open_rooms(name, room_frames, room_size, cache)
    path = Path(name)
    if is_scene_list(name) and not path.is_dir():
        return [open_scene(folder, format, scale) for folder in listed_scenes(path)]
    if format is None and poses == "given" and path.is_dir():
        return [s for folder in scene_folders(path) or [path] for s in _scenes_in(folder, scale)]
    return [open_scene(path, format, scale, poses)]


def _scenes_in(folder: Path, scale: float) -> Sequence[Scene]:
    """One scene, or one for each photo of a folder without poses."""
    return SingleViews(folder) if is_single_views(folder) else [open_scene(folder, scale=scale)]


def scene_folders(path: Path) -> list[Path]:
    """The folders right below `path` that hold a scene, unless `path` is one itself."""
    if find_format(path):
        return []
    return [folder for folder in sorted(path.iterdir()) if folder.is_dir() and find_format(folder)]


class RoomScenes(Sequence[Scene]):
    """Procedural rooms `first` .. `end` - 1 of a split, each built when it is asked for."""

    def __init__(
        self,
        split: str,
        first: int,
        end: int,
        num_frames: int = 5,
        size: tuple[int, int] = (320, 256),
        cache: str | None = None,
    ):
        self.split, self.num_frames, self.size, self.cache = split, num_frames, size, cache
        self._indices = range(first, end)

    def __len__(self) -> int:
        return len(self._indices)

    def __getitem__(self, position):
        if isinstance(position, slice):
            return [self[index] for index in range(*position.indices(len(self)))]
        return _room(self.split, self._indices[position], self.num_frames, self.size, self.cache)


@lru_cache(maxsize=4)  # tuples of one room are usually read one after the other
def _room(
    split: str, index: int, num_frames: int, size: tuple[int, int], cache: str | None
) -> Scene:
    from mvsam import rooms  # needs the extra `rooms`, which reading folders does not

    scene = rooms.scene(split, index, num_frames, *size)
    if cache is None:
        return scene
    kind = f"v{rooms.VERSION}-{size[0]}x{size[1]}-{num_frames}frames"
    return cached_scene(scene, Path(cache) / kind)


def _open_rooms(name: str, num_frames: int, size: tuple[int, int], cache: str | None) -> RoomScenes:
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
        return RoomScenes(split, 0, count, num_frames, size, cache)
    first, end = int(match[2]), int(match[3])
    if first >= end:
        raise InputError(f"{name}: the part is empty; its end must be larger than its first.")
    if count is not None and end > count:
        raise InputError(f"{name}: this split has {count} scenes; end at {count} or before.")
    return RoomScenes(split, first, end, num_frames, size, cache)
