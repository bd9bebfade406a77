"""Rigid motions as 4x4 matrices; names read `target_from_source`."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Both ways: flips y and z of the camera axes."""


def invert(target_from_source: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """`source_from_target`, by transposing the rotation (exact for rigid motions only)."""
    rotation = target_from_source[..., :3, :3].mT
    translation = -(rotation @ target_from_source[..., :3, 3:])
    top = torch.cat([rotation, translation], dim=-1)
    return torch.cat([top, target_from_source[..., 3:, :]], dim=-2)


def pose_from_quaternion(
    translation: Float[np.ndarray, "3"], quaternion: Float[np.ndarray, "4"]
) -> Float[np.ndarray, "4 4"]:
    """From (x, y, z, w), which need not have unit length; ValueError for zero or not finite."""
    norm = float(np.linalg.norm(quaternion))
    if not 1e-6 < norm < 1e6:
        raise ValueError(f"a quaternion of length {norm:g} is no rotation")
    x, y, z, w = quaternion / norm
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = translation
    return pose


def pose_from_rotation_vector(
    rotation: Float[np.ndarray, "3"], translation: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "4 4"]:
    """From axis times angle, radians (Rodrigues)."""
    half = float(np.linalg.norm(rotation)) / 2
    axis = rotation / 2 * np.sinc(half / np.pi)  # sin(half) along the axis, also for no turn
    return pose_from_quaternion(translation, np.array([*axis, np.cos(half)]))


def cross_matrix(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Skew-symmetric matrices: `cross_matrix(a) @ b` is a x b."""
    x, y, z = vectors.unbind(dim=-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))


def moved_by(
    world_from_cam: Float[Tensor, "view 4 4"], steps: Float[Tensor, "view 6"]
) -> Float[Tensor, "view 4 4"]:
    """Cameras after steps in their own axes: axis times angle (radians), then metres."""
    motions = torch.eye(4, dtype=steps.dtype).repeat(len(steps), 1, 1)
    motions[:, :3, :3] = torch.linalg.matrix_exp(cross_matrix(steps[:, :3]))
    motions[:, :3, 3] = steps[:, 3:]
    return world_from_cam @ motions
