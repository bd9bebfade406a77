"""How much cameras see of each other's viewing frusta, from poses and intrinsics alone."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from mvsam.types import Frame

GRID = (6, 5)
"""Pixels (columns, rows) of a photo whose rays stand for the frustum."""
NUM_DEPTHS = 4
BEST_ANGLES_DEG = (5.0, 10.0)
"""Triangulation angles that serve a plane sweep best: enough parallax, still similar pictures."""
FALLOFF_DEG = (2.5, 10.0)
"""Standard deviations below and above: too small an angle spoils depth sooner than a wide one."""


@dataclass(frozen=True)
class Cameras:
    """The cameras of a scene as arrays."""

    intrinsics: Float[np.ndarray, "camera 3 3"]
    world_from_cam: Float[np.ndarray, "camera 4 4"]
    sizes: Float[np.ndarray, "camera 2"]
    """(width, height) of each photo, pixels."""

    @staticmethod
    def of(frames: Sequence[Frame]) -> "Cameras":
        return Cameras(
            np.stack([frame.intrinsics for frame in frames]).astype(np.float64),
            np.stack([frame.world_from_cam for frame in frames]).astype(np.float64),
            np.array([frame.size for frame in frames], dtype=np.float64),
        )

    def __len__(self) -> int:
        return len(self.sizes)

    def with_poses(self, world_from_cam: Float[np.ndarray, "camera 4 4"]) -> "Cameras":
        return replace(self, world_from_cam=world_from_cam)

    @property
    def centres(self) -> Float[np.ndarray, "camera 3"]:
        """Metres, world."""
        return self.world_from_cam[:, :3, 3]


def frustum_overlap(
    cameras: Cameras, depth_range: tuple[float, float]
) -> Float[np.ndarray, "camera camera"]:
    """Fraction 0..1 of each frustum that another camera sees; the smaller of both directions.

    The frustum reaches over `depth_range` in metres; its points lie at the middle of equal slices
    of depth. A camera does not overlap itself (the diagonal is 0).
    """
    edges = np.linspace(*depth_range, NUM_DEPTHS + 1)
    points = frustum_points(cameras, (edges[:-1] + edges[1:]) / 2)
    axes = np.ascontiguousarray(np.moveaxis(points, -1, 0), dtype=np.float32)  # for speed
    seen = np.stack([_fraction_seen(cameras, i, axes) for i in range(len(cameras))])
    shared = np.minimum(seen, seen.T)
    np.fill_diagonal(shared, 0)
    return shared


def frustum_points(
    cameras: Cameras, depths: Float[np.ndarray, " depth"]
) -> Float[np.ndarray, "camera point 3"]:
    """World points on a coarse grid of each camera's pixels at these depths, metres."""
    columns, rows = ((np.arange(count) + 0.5) / count for count in GRID)
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    pixels = np.concatenate(
        [grid * cameras.sizes[:, None], np.ones((len(cameras), len(grid), 1))], axis=-1
    )
    rays = pixels @ np.linalg.inv(cameras.intrinsics).mT
    in_camera = (rays[:, None] * depths[:, None, None]).reshape(len(cameras), -1, 3)
    return in_camera @ cameras.world_from_cam[:, :3, :3].mT + cameras.centres[:, None]


def _fraction_seen(
    cameras: Cameras, source: int, points: Float[np.ndarray, "3 camera point"]
) -> Float[np.ndarray, " camera"]:
    """For each camera, the fraction of its points that project into the source photo."""
    rotation = cameras.world_from_cam[source, :3, :3]
    linear = cameras.intrinsics[source] @ rotation.T
    offset = linear @ cameras.centres[source]
    width, height = cameras.sizes[source].tolist()
    # Multiplied by depth instead of divided: no division by zero, and it is faster.
    u, v, depth = (
        sum(float(factor) * axis for factor, axis in zip(row, points, strict=True)) - float(shift)
        for row, shift in zip(linear, offset, strict=True)
    )
    inside = (u >= 0) & (u <= width * depth) & (v >= 0) & (v <= height * depth) & (depth > 1e-6)
    return inside.mean(-1)


def angle_preference(
    cameras: Cameras, depth_range: tuple[float, float]
) -> Float[np.ndarray, "reference source"]:
    """1 for triangulation angles within `BEST_ANGLES_DEG` at mid depth, towards 0 outside."""
    points = frustum_points(cameras, np.array([sum(depth_range) / 2]))
    angles = np.stack([_mean_angle_deg(cameras, i, points[i]) for i in range(len(cameras))])
    below = np.maximum(BEST_ANGLES_DEG[0] - angles, 0) / FALLOFF_DEG[0]
    above = np.maximum(angles - BEST_ANGLES_DEG[1], 0) / FALLOFF_DEG[1]
    return np.exp(-0.5 * (below**2 + above**2))


def _mean_angle_deg(
    cameras: Cameras, reference: int, points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, " source"]:
    """Angle at the points between the rays to the reference and to every camera, degrees."""
    rays = cameras.centres[:, None] - points
    directions = rays / np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-9)
    cosines = (directions * directions[reference]).sum(-1)
    return np.degrees(np.arccos(np.clip(cosines, -1, 1))).mean(-1)
