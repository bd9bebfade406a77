"""7-Scenes: `frame-NNNNNN.{color,depth}.png` with the pose of the depth camera beside them.

The colour camera is another one. Without registration its pictures and the depth lie up to 35
pixels apart at the borders; the calibration below was fitted to sequences photometrically
(docs/data.md).
"""

from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mvsam.data.files import check_map, check_photo, load_matrix, load_photo, load_pixels
from mvsam.data.readers.listed import ListedScene, checked, corner_intrinsics
from mvsam.data.readers.register import register_depth
from mvsam.errors import InputError
from mvsam.geometry.depth_map import from_millimetres
from mvsam.geometry.pose import pose_from_rotation_vector
from mvsam.types import Frame

DEPTH_CAMERA = corner_intrinsics(585.0, 585.0, 320.0, 240.0, has_integer_centres=True)
COLOR_CAMERA = corner_intrinsics(520.17, 520.17, 320.0, 239.17, has_integer_centres=True)
COLOR_FROM_DEPTH = pose_from_rotation_vector(
    np.array([0.0062, -0.0024, 0.0035]), np.array([-0.0201, 0.0067, 0.0014])
)
SIZE = (640, 480)
_INVALID = 65535


def is_seven_scenes(path: Path) -> bool:
    return next(path.glob("frame-*.color.png"), None) is not None


def open_seven_scenes(path: Path) -> ListedScene:
    """The scene of one sequence's folder (`chess/seq-01`). Lost frames (pose nan) are left out."""
    photos = sorted(path.glob("frame-*.color.png"))
    frames = [frame for photo in photos if (frame := _frame(photo)) is not None]
    return ListedScene(path.resolve().name, frames, num_lost=len(photos) - len(frames))


def _frame(photo: Path) -> Frame | None:
    stem = photo.name.removesuffix(".color.png")
    world_from_depth = load_matrix(photo.with_name(f"{stem}.pose.txt"), 4, 4, "pose")
    if not np.isfinite(world_from_depth).all():
        return None
    if (size := check_photo(photo)) != SIZE:
        raise InputError(f"{photo}: is {size[0]}x{size[1]}; 7-Scenes has 640x480 pictures.")
    depth = photo.with_name(f"{stem}.depth.png")
    if has_depth := depth.is_file():
        check_map(depth, "depth", SIZE)
    frame = Frame(
        name=stem,
        size=SIZE,
        intrinsics=COLOR_CAMERA.copy(),
        world_from_cam=world_from_depth @ np.linalg.inv(COLOR_FROM_DEPTH),
        load_image=partial(load_photo, photo),
        load_depth=partial(_load_depth, depth) if has_depth else None,
    )
    return checked(frame, photo)


def _load_depth(file: Path) -> Float[np.ndarray, "height width"]:
    pixels = load_pixels(file, "depth map")
    depth = from_millimetres(np.where(pixels == _INVALID, 0, pixels))
    return register_depth(depth, DEPTH_CAMERA, COLOR_CAMERA, COLOR_FROM_DEPTH, SIZE)
