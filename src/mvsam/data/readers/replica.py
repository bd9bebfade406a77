"""Replica rooms from NICE-SLAM: `results/frame*.jpg`, `results/depth*.png` and `traj.txt`."""

import json
from functools import partial
from pathlib import Path

import numpy as np

from mvsam.data.camera_checks import check_depth_scale
from mvsam.data.files import check_map, check_photo, load_photo, load_pixels
from mvsam.data.readers.listed import ListedScene, checked, corner_intrinsics
from mvsam.errors import InputError, counted
from mvsam.types import Frame

CAMERA = {"fx": 600.0, "fy": 600.0, "cx": 599.5, "cy": 339.5, "scale": 6553.5}
"""Of the published 1200x680 renderings; `cam_params.json` beside the rooms overrules it."""


def is_replica(path: Path) -> bool:
    return (path / "traj.txt").is_file() and (path / "results").is_dir()


def open_replica(path: Path) -> ListedScene:
    """The scene of one room's folder (`Replica/room0`)."""
    camera = _read_camera(path)
    photos = sorted((path / "results").glob("frame*.jpg"))
    poses = _read_trajectory(path / "traj.txt")
    if len(photos) != len(poses):
        raise InputError(
            f"{path}: {counted(len(photos), 'photo')} but {counted(len(poses), 'pose')} in "
            "traj.txt; copy all again."
        )
    frames = [_frame(photo, pose, camera) for photo, pose in zip(photos, poses, strict=True)]
    return ListedScene(path.resolve().name, frames)


def _frame(photo: Path, pose: np.ndarray, camera: dict[str, float]) -> Frame:
    size = check_photo(photo)
    depth = photo.with_name(photo.stem.replace("frame", "depth") + ".png")
    if has_depth := depth.is_file():
        check_map(depth, "depth", size)
    values = (camera[key] for key in ("fx", "fy", "cx", "cy"))
    frame = Frame(
        name=photo.stem,
        size=size,
        intrinsics=corner_intrinsics(*values, has_integer_centres=True),
        world_from_cam=pose,
        load_image=partial(load_photo, photo),
        load_depth=partial(_load_depth, depth, camera["scale"]) if has_depth else None,
    )
    return checked(frame, photo)


def _read_camera(path: Path) -> dict[str, float]:
    for file in (path / "cam_params.json", path.resolve().parent / "cam_params.json"):
        if file.is_file():
            try:
                given = json.loads(file.read_text())["camera"]
                camera = {key: float(given[key]) for key in CAMERA}
            except (
                OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError,
            ) as error:  # fmt: skip
                raise InputError(
                    f"{file}: expected an object 'camera' with {', '.join(CAMERA)} ({error!r})."
                ) from error
            check_depth_scale(camera["scale"], str(file))
            return camera
    return CAMERA


def _read_trajectory(file: Path) -> list[np.ndarray]:
    """Camera to world, sixteen numbers a line."""
    try:
        table = [[float(word) for word in line.split()] for line in file.read_text().splitlines()]
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read ({error}).") from error
    rows = [row for row in table if row]
    if wrong := next((n for n, row in enumerate(rows, start=1) if len(row) != 16), None):
        raise InputError(f"{file}: pose {wrong} has not 16 numbers.")
    return [np.array(row).reshape(4, 4) for row in rows]


def _load_depth(file: Path, scale: float) -> np.ndarray:
    return load_pixels(file, "depth map").astype(np.float32) / np.float32(scale)
