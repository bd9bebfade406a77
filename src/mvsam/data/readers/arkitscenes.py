"""Apple's ARKitScenes: `lowres_wide/ID_TIME.png`, `.pincam` files, `lowres_wide.traj`, LiDAR depth.

Apple measures the principal point from the picture's corner, as we do.
"""

from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mvsam.data.files import check_photo, load_depth, load_photo, read_header
from mvsam.data.readers.listed import ListedScene, checked, corner_intrinsics
from mvsam.data.readers.trajectory import Trajectory, read_trajectory, text_lines, time_stamp
from mvsam.data.transforms import resize_nearest
from mvsam.errors import InputError
from mvsam.geometry.pose import pose_from_rotation_vector
from mvsam.types import Frame

LONGEST_GAP = 0.005
"""Seconds between a picture and its pose: pictures come at 60 a second, poses at 10."""
_STREAMS = ("vga_wide", "lowres_wide")
"""Folders of pictures, sharper ones first; the depth shows what they show."""

Files = list[tuple[float, Path]]
"""(seconds, file), in the order of time."""


def is_arkitscenes(path: Path) -> bool:
    return _frames_folder(path) is not None


def open_arkitscenes(path: Path) -> ListedScene:
    """The scene of one video's folder (`41069021`, or its `41069021_frames`).

    Pictures without a pose within 5 ms, five of six, are left out.
    """
    folder = _frames_folder(path)
    if folder is None:
        raise InputError(f"{path}: neither lowres_wide.traj nor pictures are there; copy them.")
    trajectory = read_trajectory(
        folder / "lowres_wide.traj", 6, _world_from_cam, "time rx ry rz tx ty tz"
    )
    stream = next(name for name in _STREAMS if (folder / name).is_dir())
    photos = _timed(folder / stream, ".png")
    cameras = _timed(folder / f"{stream}_intrinsics", ".pincam")
    depths = {file.name: file for _, file in _timed(folder / "lowres_depth", ".png")}
    frames = [
        frame
        for time, photo in photos
        if (frame := _frame(photo, time, cameras, depths.get(photo.name), trajectory))
    ]
    return ListedScene(path.resolve().name, frames, num_lost=len(photos) - len(frames))


def _frame(
    photo: Path, time: float, cameras: Files, depth: Path | None, trajectory: Trajectory
) -> Frame | None:
    pose = trajectory.at(time, LONGEST_GAP)
    if pose is None:
        return None
    size = check_photo(photo)
    if not cameras:
        raise InputError(f"{photo}: has no intrinsics; copy {photo.parent.name}_intrinsics too.")
    file = min(cameras, key=lambda camera: abs(camera[0] - time))[1]
    if depth:
        read_header(depth, "depth map")
    frame = Frame(
        name=photo.stem,
        size=size,
        intrinsics=_read_camera(file, size),
        world_from_cam=pose,
        load_image=partial(load_photo, photo),
        load_depth=partial(_load_depth, depth, size) if depth else None,
    )
    return checked(frame, photo)


def _frames_folder(path: Path) -> Path | None:
    for folder in (path, path / f"{path.resolve().name}_frames"):
        has_pictures = any((folder / name).is_dir() for name in _STREAMS)
        if has_pictures and (folder / "lowres_wide.traj").is_file():
            return folder
    return None


def _timed(folder: Path, suffix: str) -> Files:
    """Files named ID_SECONDS."""
    files = []
    for file in folder.glob(f"*{suffix}") if folder.is_dir() else []:
        try:
            files.append((time_stamp(file.name.removesuffix(suffix).rpartition("_")[2]), file))
        except ValueError as error:
            raise InputError(f"{file}: its name does not end with a time; remove it.") from error
    return sorted(files)


def _read_camera(file: Path, size: tuple[int, int]) -> Float[np.ndarray, "3 3"]:
    lines = text_lines(file)
    try:
        width, height, *values = (float(word) for word in lines[0][1])
        fx, fy, cx, cy = values
    except (IndexError, ValueError) as error:
        raise InputError(f"{file}: expected 'width height fx fy cx cy' ({error}).") from error
    if (width, height) != size:
        raise InputError(
            f"{file}: is for {width:g}x{height:g}, its picture is {size[0]}x{size[1]}."
        )
    return corner_intrinsics(fx, fy, cx, cy, has_integer_centres=False)


def _world_from_cam(values: Float[np.ndarray, "6"]) -> Float[np.ndarray, "4 4"]:
    """The file holds axis times angle and translation of world to camera, OpenCV axes."""
    return np.linalg.inv(pose_from_rotation_vector(values[:3], values[3:]))


def _load_depth(file: Path, size: tuple[int, int]) -> Float[np.ndarray, "height width"]:
    return resize_nearest(load_depth(file), size)
