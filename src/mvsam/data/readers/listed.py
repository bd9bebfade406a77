"""What most readers return: a scene whose frames are already listed."""

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mvsam.data.camera_checks import check_intrinsics, check_pose
from mvsam.data.labels import SCANNET20, ClassTable
from mvsam.errors import InputError
from mvsam.types import Frame

log = logging.getLogger("mvsam")


class ListedScene:
    """A `Scene` of these frames.

    Raises `InputError` for none, for two of one name, and for photos of different sizes that share
    their intrinsics, of which some must be wrong.

    points: sparse points of the surfaces in world axes, in the unit of the poses.
    num_lost: pictures that are left out for want of a pose; a message says so.
    has_poses: whether the frames' poses mean anything. has_unit: whether they are in metres; a
    COLMAP model's unit is arbitrary.
    """

    def __init__(
        self,
        name: str,
        frames: Sequence[Frame],
        views: list[tuple[int, ...]] | None = None,
        classes: ClassTable = SCANNET20,
        points: Float[np.ndarray, "point 3"] | None = None,
        num_lost: int = 0,
        has_poses: bool = True,
        has_unit: bool = True,
    ):
        warn_of_lost(name, len(frames) + num_lost, num_lost)
        if not frames:
            raise InputError(f"{name}: no frame with a picture and a pose was found there.")
        names = [frame.name for frame in frames]
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise InputError(f"{name}: two frames are called {twice}; rename one.")
        _check_shared_intrinsics(name, frames)
        self.name = name
        self.classes = classes
        self.points = points
        self.num_lost = num_lost
        self.has_poses = has_poses
        self.has_unit = has_unit
        self._frames = list(frames)
        self._views = views

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> Frame:
        return self._frames[index]

    def views(self) -> list[tuple[int, ...]] | None:
        """The tuples the data prescribe, or None."""
        return self._views


def warn_of_lost(scene: str, total: int, num_lost: int) -> None:
    """Says how many pictures have no pose; InputError where none has one."""
    if num_lost and num_lost == total:
        raise InputError(
            f"{scene}: none of its {total} pictures has a pose; tracking was lost, or time "
            "stamps do not match."
        )
    if num_lost:
        log.warning("%s: %d of %d frames have no pose; they are left out.", scene, num_lost, total)


def _check_shared_intrinsics(scene: str, frames: Sequence[Frame]) -> None:
    first_with: dict[bytes, Frame] = {}
    for frame in frames:
        other = first_with.setdefault(frame.intrinsics.tobytes(), frame)
        if other.size != frame.size:
            sizes = " and ".join(f"{f.name} ({f.size[0]}x{f.size[1]})" for f in (other, frame))
            raise InputError(
                f"{scene}: photos {sizes} differ in size but share their intrinsics; give each its "
                "own, or resize the photos."
            )


def corner_intrinsics(
    fx: float, fy: float, cx: float, cy: float, has_integer_centres: bool
) -> Float[np.ndarray, "3 3"]:
    """The pinhole matrix in the corner convention.

    has_integer_centres: the calibration puts the first pixel's centre at (0, 0), as OpenCV does;
    else at (0.5, 0.5), as COLMAP and nerfstudio do.
    """
    shift = 0.5 if has_integer_centres else 0.0
    return np.array([[fx, 0, cx + shift], [0, fy, cy + shift], [0, 0, 1.0]])


def checked(frame: Frame, item: str | Path) -> Frame:
    """The frame, if its pose and intrinsics are believable; else InputError names `item`."""
    check_pose(frame.world_from_cam, str(item))
    check_intrinsics(frame.intrinsics, frame.size, str(item))
    return frame


def file_inside(folder: Path, relative: object, item: str) -> Path:
    """`folder / relative`; InputError for a path that is absolute or leaves the folder.

    The path's text decides, so that a data file cannot name what lies elsewhere. Links inside the
    folder may lead out of it: whoever owns the disk made them, to keep large data on another one.
    """
    if not isinstance(relative, str) or not relative or "\0" in relative:
        raise InputError(f"{item}: {relative!r} is no file path; write one relative to {folder}.")
    path = Path(relative)
    depth = 0
    for part in path.parts:
        depth += -1 if part == ".." else part != "."
        if depth < 0 or path.is_absolute():
            raise InputError(f"{item}: {relative} leaves the folder {folder}; keep files inside.")
    if depth == 0:
        raise InputError(f"{item}: {relative} is the folder {folder} itself; name a file in it.")
    return folder / path


def numbered_files(folder: Path, suffixes: Sequence[str]) -> dict[int, Path]:
    """Frame number -> file, of those named by a number; empty where the folder is missing."""
    files: dict[int, Path] = {}
    for file in sorted(folder.iterdir()) if folder.is_dir() else []:
        if file.suffix.lower() in suffixes and file.stem.isdecimal():
            if int(file.stem) in files:
                raise InputError(f"{file}: there are two files of frame {int(file.stem)}.")
            files[int(file.stem)] = file
    return files
