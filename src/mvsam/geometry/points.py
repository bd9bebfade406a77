"""Pixels to points and back, in NumPy: what `warp.py` does on tensors while it samples.

Points lie in the axes of a camera: x right, y down, z forward, metres.
"""

import numpy as np
from jaxtyping import Float

from mvsam.geometry.warp import MINIMUM_Z


def viewing_rays(
    columns: np.ndarray, rows: np.ndarray, intrinsics: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "*pixels 3"]:
    """Points at depth 1 behind the centres of the pixels with these indices."""
    homogeneous = np.stack([columns + 0.5, rows + 0.5, np.ones(np.shape(columns))], axis=-1)
    return homogeneous @ np.linalg.inv(intrinsics).T


def to_pixels(
    points: Float[np.ndarray, "*points 3"], intrinsics: Float[np.ndarray, "3 3"]
) -> tuple[Float[np.ndarray, "*points 2"], Float[np.ndarray, "*points"]]:
    """Pixel coordinates (corner convention), infinite where the camera sees none, and depths."""
    depth = points[..., 2]
    in_front = depth > MINIMUM_Z
    homogeneous = points @ intrinsics.T
    pixels = homogeneous[..., :2] / np.where(in_front, depth, 1.0)[..., None]
    return np.where(in_front[..., None], pixels, np.inf), depth


def moved(
    points: Float[np.ndarray, "*points 3"], target_from_source: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "*points 3"]:
    """The same points in other axes."""
    return points @ target_from_source[:3, :3].T + target_from_source[:3, 3]
