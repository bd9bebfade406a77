"""A box-shaped textured room with exact depth, labels and cameras, written as a posed folder.

The cameras stand inside an empty axis-aligned box, so every ray ends on exactly one of six planes
and nothing is ever occluded: warping at the true depth must reproduce the other views.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from mvsam.types import IGNORE, Frame

BOX_MIN = np.array([-2.0, -1.3, -1.0])
BOX_MAX = np.array([2.0, 1.2, 3.0])
"""Corners of the room, metres; y points down, so y = 1.2 is the floor."""
FACE_LABELS = {"x": 0, "floor": 1, "ceiling": IGNORE, "z": 0}


@dataclass(frozen=True)
class SyntheticView:
    """The truth behind one written photo."""

    name: str
    intrinsics: np.ndarray
    """Corner convention (the written file holds 0.5 less)."""
    world_from_cam: np.ndarray
    image: np.ndarray
    depth: np.ndarray
    labels: np.ndarray


def camera_intrinsics(size: tuple[int, int]) -> np.ndarray:
    """About 64 degrees of horizontal view, corner convention."""
    width, height = size
    focal = 0.8 * width
    return np.array([[focal, 0, width / 2 + 0.3], [0, focal, height / 2 - 0.2], [0, 0, 1.0]])


def camera_pose(index: float, baseline: float = 0.1, yaw_deg: float = 3.0) -> np.ndarray:
    """Steps of `baseline` metres to the right, each turning `yaw_deg` to the left."""
    angle = np.deg2rad(-yaw_deg * index)
    pose = np.eye(4)
    pose[0, 0] = pose[2, 2] = np.cos(angle)
    pose[0, 2] = np.sin(angle)
    pose[2, 0] = -np.sin(angle)
    pose[:3, 3] = [baseline * index - 0.2, 0.05 * index, -0.3]
    return pose


def texture(points: np.ndarray) -> np.ndarray:
    """Smooth RGB in [0, 1] as a function of the world point, so that views agree exactly."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    red = 0.5 + 0.4 * np.sin(9 * x + 4 * y) * np.cos(7 * z)
    green = 0.5 + 0.4 * np.sin(5 * y - 6 * z + 1)
    blue = 0.5 + 0.4 * np.cos(8 * z + 3 * x - 2 * y)
    return np.stack([red, green, blue], axis=-1)


def render(
    size: tuple[int, int], intrinsics: np.ndarray, world_from_cam: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(image uint8, z-depth float32 metres, labels uint8) of the box from inside."""
    width, height = size
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([columns, rows, np.ones_like(columns)], axis=-1)
    rays = pixels @ np.linalg.inv(intrinsics).T @ world_from_cam[:3, :3].T
    center = world_from_cam[:3, 3]
    with np.errstate(divide="ignore"):
        exits = np.where(rays > 0, (BOX_MAX - center) / rays, (BOX_MIN - center) / rays)
    exits = np.where(rays == 0, np.inf, exits)
    axis = exits.argmin(-1)
    depth = exits.min(-1)  # rays have z = 1 in the camera, so the ray parameter is the z-depth
    labels = np.full((height, width), FACE_LABELS["x"], np.uint8)
    labels[axis == 2] = FACE_LABELS["z"]
    labels[(axis == 1) & (rays[..., 1] > 0)] = FACE_LABELS["floor"]
    labels[(axis == 1) & (rays[..., 1] < 0)] = FACE_LABELS["ceiling"]
    points = center + depth[..., None] * rays
    image = np.rint(255 * texture(points)).astype(np.uint8)
    return image, depth.astype(np.float32), labels


def synthetic_views(
    num_frames: int = 3, size: tuple[int, int] = (64, 48), baseline: float = 0.1
) -> list[SyntheticView]:
    """The frames that `write_posed_folder` writes, kept in memory."""
    intrinsics = camera_intrinsics(size)
    views = []
    for index in range(num_frames):
        pose = camera_pose(index, baseline)
        image, depth, labels = render(size, intrinsics, pose)
        views.append(SyntheticView(f"{index:04d}", intrinsics, pose, image, depth, labels))
    return views


def write_posed_folder(
    path: Path,
    num_frames: int = 3,
    size: tuple[int, int] = (64, 48),
    *,
    baseline: float = 0.1,
    depth: bool = True,
    labels: bool = True,
    views: bool = False,
    extension: str = "png",
) -> list[SyntheticView]:
    """Write a valid posed folder and return the truth; tests then break one file at a time.

    `views` also writes a `views.txt`: every frame is a reference with all others as sources.
    """
    truth = synthetic_views(num_frames, size, baseline)
    for folder in ("color", "poses", *["depth"] * depth, *["labels"] * labels):
        (path / folder).mkdir(parents=True, exist_ok=True)
    integer_centres = truth[0].intrinsics - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    np.savetxt(path / "intrinsics.txt", integer_centres, fmt="%.8f")
    for view in truth:
        Image.fromarray(view.image).save(path / "color" / f"{view.name}.{extension}")
        np.savetxt(path / "poses" / f"{view.name}.txt", view.world_from_cam, fmt="%.8f")
        if depth:
            millimetres = np.rint(1000 * view.depth).astype(np.uint16)
            Image.fromarray(millimetres).save(path / "depth" / f"{view.name}.png")
        if labels:
            Image.fromarray(view.labels).save(path / "labels" / f"{view.name}.png")
    if views:
        names = [view.name for view in truth]
        lines = [" ".join([n, *(m for m in names if m != n)]) for n in names]
        (path / "views.txt").write_text("# reference, sources\n" + "\n".join(lines) + "\n")
    return truth


def depth_of(frame: Frame) -> np.ndarray:
    """The depth of a frame that has one."""
    depth = frame.depth
    assert depth is not None
    return depth


def labels_of(frame: Frame) -> np.ndarray:
    """The labels of a frame that has some."""
    labels = frame.labels
    assert labels is not None
    return labels
