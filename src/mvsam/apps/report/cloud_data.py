"""What `viewer.js` draws, as numbers and base64: points, cameras, and where to look from first."""

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from mvsam.apps.report.thumbnails import confidence_colors
from mvsam.data.labels import ClassTable, lookup_table
from mvsam.data.sampling import evenly_spaced
from mvsam.reconstruction.cloud import PointCloud, VoxelGrid
from mvsam.reconstruction.filtering import Camera
from mvsam.types import IGNORE

MOST_POINTS = 200_000
MOST_CAMERAS = 300
STEPS = 65535
"""Positions are whole numbers from 0 to this over the box around the cloud."""
UNLABELLED_GREY = (128, 128, 128)


def cloud_data(
    cloud: PointCloud, voxel_size: float, cameras: Sequence[Camera], classes: ClassTable
) -> dict[str, Any]:
    """The JSON of the 3D view; `voxel_size` (metres) is how far apart the cloud's points are."""
    cloud, voxel_size = thinned(cloud, voxel_size, MOST_POINTS)
    low = cloud.points.min(axis=0).astype(np.float64)
    extent = np.maximum(cloud.points.max(axis=0) - low, 1e-6)
    palette = lookup_table(classes)
    palette[IGNORE] = UNLABELLED_GREY
    view = first_view(cloud.points, cameras)
    return {
        "low": low.tolist(),
        "extent": extent.tolist(),
        "voxelSize": voxel_size,
        "positions": _base64(np.rint((cloud.points - low) / extent * STEPS), "<u2"),
        "colors": _base64(cloud.colors, "u1"),
        "labels": _base64(cloud.labels, "u1"),
        "confidence": _base64(np.rint(cloud.confidence * 255), "u1"),
        "palette": palette.tolist(),
        "unsureToSure": confidence_colors(np.linspace(0, 1, 256)).tolist(),
        "frusta": _base64(frusta(cameras, 0.05 * view["distance"]), "<f4"),
        "firstView": view,
    }


def thinned(cloud: PointCloud, voxel_size: float, most: int) -> tuple[PointCloud, float]:
    """At most so many points, merged in larger voxels where they were more, and their size."""
    while len(cloud) > most:
        # Points lie on surfaces: their number falls with the square of the voxel's edge.
        voxel_size *= 1.02 * float(np.sqrt(len(cloud) / most))
        grid = VoxelGrid(voxel_size)
        grid.add(cloud)
        cloud = grid.cloud()
    return cloud, voxel_size


def first_view(points: Float[np.ndarray, "point 3"], cameras: Sequence[Camera]) -> dict[str, Any]:
    """From behind the mean camera, looking where the cameras look.

    The view circles around `target` at `distance` metres. `up` is the mean up of the cameras, for
    nobody says what is up in the world; `front` is level and of length 1, `pitch` how far the view
    looks down, radians.
    """
    poses = np.stack([camera.world_from_cam for camera in cameras])
    center, look = poses[:, :3, 3].mean(axis=0), poses[:, :3, 2].mean(axis=0)
    up = _unit(-poses[:, :3, 1].mean(axis=0), -poses[0, :3, 1])
    goes_round = np.linalg.norm(look) < 0.5  # the cameras look to all sides
    look = _unit(look, poses[0, :3, 2])
    front = _unit(look - (look @ up) * up, _across(up))
    pitch = float(np.arcsin(np.clip(-look @ up, -1, 1)))
    ahead = (points - center) @ look
    depth = float(np.median(ahead[ahead > 0])) if np.any(ahead > 0) else 1.0
    target, distance = center + depth * look, 1.25 * depth
    if goes_round:
        target, pitch = np.median(points, axis=0), 0.7
        distance = 1.2 * float(np.linalg.norm(np.ptp(points, axis=0)))
    vectors = {"up": up, "front": front, "target": target}
    return {name: vector.tolist() for name, vector in vectors.items()} | {
        "distance": distance,
        "pitch": pitch,
    }


def frusta(cameras: Sequence[Camera], size: float) -> Float[np.ndarray, "camera 16 3"]:
    """Ends of the 8 lines that draw each camera: four edges of `size` metres and their rim."""
    lines = []
    for camera in evenly_spaced(cameras, MOST_CAMERAS):
        width, height = camera.size
        corners = np.array([(0, 0, 1), (width, 0, 1), (width, height, 1), (0, height, 1)])
        rays = size * corners @ np.linalg.inv(camera.intrinsics).T
        rim = rays @ camera.world_from_cam[:3, :3].T + camera.world_from_cam[:3, 3]
        center = np.broadcast_to(camera.world_from_cam[:3, 3], (4, 3))
        edges = np.stack([center, rim], axis=1)
        sides = np.stack([rim, np.roll(rim, -1, axis=0)], axis=1)
        lines.append(np.concatenate([edges, sides]).reshape(16, 3))
    return np.stack(lines)


def _unit(vector: Float[np.ndarray, "3"], otherwise: np.ndarray) -> Float[np.ndarray, "3"]:
    """Of length 1; `otherwise` where it has no direction."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-3 else otherwise


def _across(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Some direction at a right angle to a unit vector."""
    axis = np.eye(3)[np.argmin(np.abs(vector))]
    return _unit(np.cross(vector, axis), axis)


def _base64(values: Shaped[np.ndarray, "..."], kind: str) -> str:
    return base64.b64encode(values.astype(kind).tobytes()).decode()
