"""What makes intrinsics and a pose believable; each check raises with the remedy."""

import numpy as np
from jaxtyping import Float

from mvsam.errors import InputError

RIGID_TOLERANCE = 4e-3
"""Largest entry of R^T R - I; files that keep three digits stay below. So do rotations
scaled by less than 0.2 %, and depth is off by as much."""

FARTHEST_CAMERA = 10_000.0
"""Metres from the origin."""

DEPTH_SCALES = (1e-6, 1e6)
"""Least and largest metres a unit of a depth map, or units in a metre."""


def check_intrinsics(matrix: Float[np.ndarray, "3 3"], size: tuple[int, int], item: str) -> None:
    """Raise unless `matrix` is a pinhole calibration of a picture of this (width, height)."""
    width, height = size
    (fx, _, cx), (_, fy, cy), _ = matrix
    if not np.isfinite(matrix).all():
        raise InputError(f"{item}: the intrinsics are not finite; calibrate the camera again.")
    if not (fx > 0 and fy > 0):
        raise InputError(
            f"{item}: the focal lengths must be positive, not {fx:g} and {fy:g}; a negative one "
            "means mirrored axes, so negate it and the matching axis of the poses."
        )
    if not all(0.01 < f / max(size) < 1000 for f in (fx, fy)):
        raise InputError(
            f"{item}: focal lengths of {fx:g} and {fy:g} pixels are no camera's for "
            f"{width}x{height} photos; are they in millimetres, or metres?"
        )
    if matrix[1, 0] != 0 or not np.allclose(matrix[2], [0, 0, 1]):
        raise InputError(
            f"{item}: the intrinsics are not of the form [fx s cx; 0 fy cy; 0 0 1]"
            f"{' but look transposed' if np.allclose(matrix[:, 2], [0, 0, 1]) else ''}; "
            "write them in that order."
        )
    if not (0 < cx < width and 0 < cy < height):
        raise InputError(
            f"{item}: the principal point ({cx:g}, {cy:g}) is outside the {width}x{height} photo; "
            "scale the first two rows of the intrinsics to the size of the photos."
        )


def check_depth_scale(scale: float, item: str) -> None:
    """Raise unless `scale` can be metres a unit of a depth map, or units in a metre."""
    least, largest = DEPTH_SCALES
    if not least <= scale <= largest:
        raise InputError(
            f"{item}: the depth scale is {scale:g}, expected {least:g} to {largest:g}; write what "
            "a depth of 1 means."
        )


def check_pose(matrix: Float[np.ndarray, "4 4"], item: str) -> None:
    """Raise unless `matrix` is a finite rigid motion."""
    if not np.isfinite(matrix).all():
        raise InputError(
            f"{item}: the pose is not finite (some recorders write inf or nan where tracking "
            "was lost); leave this frame out."
        )
    if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
        looks_transposed = np.allclose(matrix[:, 3], [0, 0, 0, 1], atol=1e-6)
        raise InputError(
            f"{item}: the pose is not rigid, its last row is not 0 0 0 1"
            f"{'; it looks transposed' if looks_transposed else ''}; "
            "write [R t; 0 0 0 1], camera to world, row by row."
        )
    _check_rotation(matrix[:3, :3], item)
    if (distance := np.abs(matrix[:3, 3]).max()) > FARTHEST_CAMERA:
        raise InputError(
            f"{item}: the camera is {distance:.0f} m from the origin, where single precision loses "
            "millimetres; subtract one offset from all poses, or convert them to metres."
        )


def _check_rotation(rotation: Float[np.ndarray, "3 3"], item: str) -> None:
    if (largest := np.abs(rotation).max()) > 1e6:  # the square of a much larger one overflows
        raise InputError(
            f"{item}: the pose is not rigid, its upper left 3x3 holds {largest:.3g}; it must be a "
            "pure rotation."
        )
    gram, determinant = rotation.T @ rotation, np.linalg.det(rotation)
    if np.abs(gram - np.eye(3)).max() <= RIGID_TOLERANCE:
        if determinant < 0:
            raise InputError(
                f"{item}: the pose is not rigid but mirrors the world (determinant -1); "
                "use right-handed axes, x right, y down, z forward."
            )
        return
    scale = np.cbrt(abs(determinant))
    is_scaled = scale > 0 and np.abs(gram / scale**2 - np.eye(3)).max() <= RIGID_TOLERANCE
    cause = f", it is scaled by {scale:.4g}" if is_scaled else ""
    raise InputError(
        f"{item}: the pose is not rigid{cause}; the upper left 3x3 must be a pure rotation."
    )
