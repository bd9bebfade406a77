"""TUM RGB-D sequences: colour, depth and trajectory in three lists, joined by their time stamps."""

import logging
import re
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mvsam.data.files import check_map, check_photo, load_matrix, load_photo, load_pixels
from mvsam.data.readers.listed import (
    ListedScene,
    checked,
    corner_intrinsics,
    file_inside,
)
from mvsam.data.readers.trajectory import (
    nearest_in_time,
    read_trajectory,
    text_lines,
    time_stamp,
    tum_pose,
)
from mvsam.data.readers.undistort import Distortion, undistort
from mvsam.errors import InputError
from mvsam.geometry.camera import HALF_PIXEL
from mvsam.types import Frame

DEPTH_UNITS = 5000.0
"""In a metre."""
LINE = "time tx ty tz qx qy qz qw"
LONGEST_GAP = 0.02
"""Seconds between stamps that still belong together, as the benchmark's own tool has it."""

_CALIBRATIONS = {
    "freiburg1": ((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, 1.1633), (-0.0054, 0.0026)),
    "freiburg2": ((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, 0.9172), (-0.0033, -0.0001)),
    "freiburg3": ((535.4, 539.2, 320.1, 247.6), (), (0.0, 0.0)),
}
"""Colour cameras as the benchmark publishes them: fx, fy, cx, cy; radial; tangential."""
_DEFAULT = (525.0, 525.0, 319.5, 239.5)
_SIZE = (640, 480)
"""(width, height) of photos of all three."""

log = logging.getLogger("mvsam")


def is_tum(path: Path) -> bool:
    return (path / "rgb.txt").is_file() and (path / "groundtruth.txt").is_file()


def open_tum(path: Path) -> ListedScene:
    """The scene of a sequence's folder, one frame for each photo that has a pose in time.

    Intrinsics: `intrinsics.txt` if there is one (3x3, integer pixel centres), else those of the
    freiburg camera in the folder's name, else 525 pixels with a message; InputError where photos
    are not of the benchmark's size, so that it cannot be.
    """
    photos = _read_list(path / "rgb.txt")
    depths = _read_list(path / "depth.txt") if (path / "depth.txt").is_file() else []
    trajectory = read_trajectory(path / "groundtruth.txt", 7, tum_pose, LINE)
    depth_times = np.array([time for time, _ in depths])
    intrinsics, distortion = _camera(path)
    frames = []
    for time, relative in photos:
        pose = trajectory.at(time, LONGEST_GAP)
        if pose is None:
            continue
        depth = nearest_in_time(depth_times, time, LONGEST_GAP)
        depth_file = None if depth is None else depths[depth][1]
        frames.append(_frame(path, relative, depth_file, pose, intrinsics, distortion))
    return ListedScene(path.resolve().name, frames, num_lost=len(photos) - len(frames))


def _frame(
    path: Path,
    photo: str,
    depth: str | None,
    pose: np.ndarray,
    intrinsics: np.ndarray,
    distortion: Distortion,
) -> Frame:
    file = file_inside(path, photo, str(path / "rgb.txt"))
    size = check_photo(file)
    if size != _SIZE and not (path / "intrinsics.txt").is_file():
        raise InputError(
            f"{file}: is {size[0]}x{size[1]}, which none of the benchmark's cameras takes: write "
            f"your camera's 3x3 intrinsics, in OpenCV's convention, to {path / 'intrinsics.txt'}."
        )
    depth_file = None if depth is None else file_inside(path, depth, str(path / "depth.txt"))
    if depth_file is not None:
        check_map(depth_file, "depth", size)
    frame = Frame(
        name=Path(photo).stem,
        size=size,
        intrinsics=intrinsics,
        world_from_cam=pose,
        load_image=partial(_load_photo, file, intrinsics, distortion),
        load_depth=partial(_load_depth, depth_file, intrinsics, distortion) if depth_file else None,
    )
    return checked(frame, file)


def _read_list(file: Path) -> list[tuple[float, str]]:
    """(seconds, relative path) a line."""
    entries = []
    for number, words in text_lines(file):
        try:
            entries.append((time_stamp(words[0]), words[1]))
        except (ValueError, IndexError) as error:
            raise InputError(
                f"{file} line {number}: expected a time stamp and a file ({error})."
            ) from error
    return entries


def _camera(path: Path) -> tuple[Float[np.ndarray, "3 3"], Distortion]:
    own = path / "intrinsics.txt"
    if own.is_file():
        matrix = load_matrix(own, 3, 3, "intrinsics matrix")
        return matrix + HALF_PIXEL, Distortion()
    match = re.search("freiburg[123]", path.resolve().name)
    if match:
        values, radial, tangential = _CALIBRATIONS[match[0]]
        lens = Distortion("brown", radial, tangential)
        return corner_intrinsics(*values, has_integer_centres=True), lens
    log.warning(
        "%s: not named after a freiburg camera; taking a focal length of 525 pixels. Write your "
        "camera's 3x3 intrinsics to intrinsics.txt there.",
        path,
    )
    return corner_intrinsics(*_DEFAULT, has_integer_centres=True), Distortion()


def _load_photo(file: Path, intrinsics: np.ndarray, distortion: Distortion) -> np.ndarray:
    photo = load_photo(file)
    return photo if distortion.is_none else undistort(photo, intrinsics, distortion)


def _load_depth(file: Path, intrinsics: np.ndarray, distortion: Distortion) -> np.ndarray:
    depth = load_pixels(file, "depth map").astype(np.float32) / np.float32(DEPTH_UNITS)
    return depth if distortion.is_none else undistort(depth, intrinsics, distortion, outside=0)
