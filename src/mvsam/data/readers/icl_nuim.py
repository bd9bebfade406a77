"""ICL-NUIM's rendered rooms in their TUM form: `rgb/`, `depth/` and `*.gt.freiburg`.

The renderer's y axes point up: the published focal length in y is -480, and poses belong to that
left-handed world. Negating the y axes of camera and world makes both ours.
"""

from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mvsam.data.files import check_map, check_photo, load_photo, load_pixels
from mvsam.data.readers.listed import ListedScene, checked, corner_intrinsics, numbered_files
from mvsam.data.readers.trajectory import read_trajectory, tum_pose
from mvsam.errors import InputError
from mvsam.types import Frame

CAMERA = corner_intrinsics(481.2, 480.0, 319.5, 239.5, has_integer_centres=True)
SIZE = (640, 480)
DEPTH_UNITS = 5000.0
"""In a metre."""
_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def is_icl_nuim(path: Path) -> bool:
    return (path / "rgb").is_dir() and next(path.glob("*.gt.freiburg"), None) is not None


def open_icl_nuim(path: Path) -> ListedScene:
    """The scene of one trajectory's folder; a picture's number is its time stamp."""
    files = sorted(path.glob("*.gt.freiburg"))
    if len(files) > 1:
        raise InputError(f"{path}: holds {len(files)} trajectories; keep that of its pictures.")
    trajectory = read_trajectory(files[0], 7, tum_pose, "number tx ty tz qx qy qz qw")
    photos = numbered_files(path / "rgb", (".png", ".jpg"))
    depths = numbered_files(path / "depth", (".png",))
    frames = []
    for number, photo in sorted(photos.items()):
        pose = trajectory.at(float(number), longest_gap=0.0)
        if pose is not None:
            frames.append(_frame(photo, depths.get(number), pose))
    return ListedScene(path.resolve().name, frames, num_lost=len(photos) - len(frames))


def _frame(photo: Path, depth: Path | None, pose: Float[np.ndarray, "4 4"]) -> Frame:
    if (size := check_photo(photo)) != SIZE:
        raise InputError(f"{photo}: is {size[0]}x{size[1]}; ICL-NUIM has 640x480 pictures.")
    if depth:
        check_map(depth, "depth", SIZE)
    frame = Frame(
        name=photo.stem,
        size=SIZE,
        intrinsics=CAMERA.copy(),
        world_from_cam=_MIRROR @ pose @ _MIRROR,
        load_image=partial(load_photo, photo),
        load_depth=partial(_load_depth, depth) if depth else None,
    )
    return checked(frame, photo)


def _load_depth(file: Path) -> Float[np.ndarray, "height width"]:
    return load_pixels(file, "depth map").astype(np.float32) / np.float32(DEPTH_UNITS)
