"""ARKit scans as the iPhone app ios_logger writes them: `Frames.m4v`, `Frames.txt`, `ARposes.txt`.

Frames.txt: time, number, fx, fy, cx, cy a line. ARposes.txt: time, tx, ty, tz, qw, qx, qy, qz,
camera to world in ARKit's axes (y up, z backward). Apple measures the principal point from the
picture's corner, as we do.
"""

import logging
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mvsam.data.files import check_photo, load_photo
from mvsam.data.keyframes import keyframes
from mvsam.data.readers.listed import ListedScene, checked, corner_intrinsics, numbered_files
from mvsam.data.readers.trajectory import Trajectory, read_trajectory, text_lines, time_stamp
from mvsam.data.readers.video import extract_frames
from mvsam.data.transforms import resize_intrinsics
from mvsam.errors import InputError, counted
from mvsam.geometry.pose import OPENCV_FROM_OPENGL, pose_from_quaternion
from mvsam.types import Frame

LONGEST_GAP = 0.02
"""Seconds between a picture and its pose."""
_PICTURE_FOLDERS = ("frames", "images")
_VIDEO_SIZES = ((1920, 1440), (1920, 1080), (1440, 1080), (1280, 720), (640, 480), (3840, 2160))
"""(width, height) that ARKit records."""

log = logging.getLogger("mvsam")


def is_ios_logger(path: Path) -> bool:
    return (path / "ARposes.txt").is_file() and (path / "Frames.txt").is_file()


def open_ios_logger(path: Path) -> ListedScene:
    """The scene of one recording's folder.

    Pictures come from `frames/` or `images/`, numbered as in Frames.txt. Where there is none, the
    keyframes of the video (10 cm or 15 degrees apart) are decoded into `frames/` first.
    """
    trajectory = read_trajectory(
        path / "ARposes.txt", 7, _arkit_pose, "time, tx, ty, tz, qw, qx, qy, qz"
    )
    shots = _read_shots(path / "Frames.txt", trajectory)
    if not shots:
        raise InputError(f"{path}: no picture of Frames.txt has a pose in time in ARposes.txt.")
    pictures = _pictures(path, shots)
    frames = [
        _frame(pictures[number], camera, pose)
        for number, (camera, pose) in shots.items()
        if number in pictures
    ]
    return ListedScene(path.resolve().name, frames, num_lost=len(pictures) - len(frames))


Shots = dict[int, tuple[Float[np.ndarray, "4"], Float[np.ndarray, "4 4"]]]
"""Number in the video -> (fx, fy, cx, cy in pixels, camera to world)."""


def _read_shots(file: Path, trajectory: Trajectory) -> Shots:
    shots: Shots = {}
    for line, words in text_lines(file):
        try:
            time, (number, *camera) = time_stamp(words[0]), (float(word) for word in words[1:])
            if len(camera) != 4 or not 0 <= number < 1e9:
                raise ValueError(f"{len(words)} numbers")
        except ValueError as error:
            raise InputError(
                f"{file} line {line}: expected 'time, number, fx, fy, cx, cy' ({error})."
            ) from error
        pose = trajectory.at(time, LONGEST_GAP)
        if pose is not None:
            shots[int(number)] = np.array(camera), pose
    return shots


def _pictures(path: Path, shots: Shots) -> dict[int, Path]:
    """Number -> picture; what an interrupted decoding left out is decoded now."""
    found: dict[int, Path] = {}
    for folder in _PICTURE_FOLDERS:
        found = found or numbered_files(path / folder, (".jpg", ".jpeg", ".png"))
    video, numbers = path / "Frames.m4v", sorted(shots)
    kept = {numbers[i] for i in keyframes([shots[number][1] for number in numbers])}
    if found and not (video.is_file() and found.keys() < kept):
        return found
    if not video.is_file():
        raise InputError(f"{path}: neither Frames.m4v nor a folder frames/ with pictures is there.")
    log.info("%s: %s decoded into %s.", video, counted(len(kept), "keyframe"), path / "frames")
    return extract_frames(video, path / "frames", kept.__contains__, end=max(kept) + 1)


def _frame(photo: Path, camera: Float[np.ndarray, "4"], pose: Float[np.ndarray, "4 4"]) -> Frame:
    size = check_photo(photo)
    fx, fy, cx, cy = camera
    intrinsics = corner_intrinsics(fx, fy, cx, cy, has_integer_centres=False)
    frame = Frame(
        name=photo.stem,
        size=size,
        intrinsics=resize_intrinsics(intrinsics, _calibrated_size(cx, cy), size),
        world_from_cam=pose,
        load_image=partial(load_photo, photo),
    )
    return checked(frame, photo)


def _calibrated_size(cx: float, cy: float) -> tuple[int, int]:
    """The ARKit video whose middle is nearest: pictures may be smaller than the video was."""
    return min(_VIDEO_SIZES, key=lambda size: abs(size[0] - 2 * cx) + abs(size[1] - 2 * cy))


def _arkit_pose(values: Float[np.ndarray, "7"]) -> Float[np.ndarray, "4 4"]:
    w, x, y, z = values[3:]
    return pose_from_quaternion(values[:3], np.array([x, y, z, w])) @ OPENCV_FROM_OPENGL
