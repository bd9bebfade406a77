"""Which frames of a stream are worth keeping: those from a new place or in a new direction."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

BASELINE = 0.1
"""Metres."""
ANGLE_DEG = 15.0


def keyframes(
    poses: Sequence[Float[np.ndarray, "4 4"]],
    baseline: float = BASELINE,
    angle_deg: float = ANGLE_DEG,
) -> list[int]:
    """Indices of the first frame and of each that moved or turned enough since the last one kept.

    baseline: metres between the cameras. angle_deg: between their orientations, rolling included.
    Poses are camera-to-world, or all in one other convention with the same distances.
    """
    kept: list[int] = []
    for index, pose in enumerate(poses):
        if not kept or _is_new(poses[kept[-1]], pose, baseline, angle_deg):
            kept.append(index)
    return kept


def _is_new(
    last: Float[np.ndarray, "4 4"],
    pose: Float[np.ndarray, "4 4"],
    baseline: float,
    angle_deg: float,
) -> bool:
    distance = float(np.linalg.norm(pose[:3, 3] - last[:3, 3]))
    cosine = (np.trace(last[:3, :3].T @ pose[:3, :3]) - 1) / 2
    return distance >= baseline or float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))) >= angle_deg
