"""Light at surface points: lamps and windows with soft shadows, and the dim light of corners.

Each point gets few rays, in a pattern shifted by its `phase`; `smoothing` then averages neighbours
with different phases along surfaces: light varies slowly where paint and grain do not.
"""

import numpy as np
from jaxtyping import Float

from .room import Room, row_dot

_LIFT = 1e-3
"""Rays start this far off the surface, metres."""
_CORNER_REACH = 0.9
"""Surfaces within this distance take ambient light away, metres."""


def irradiance(
    room: Room,
    position: Float[np.ndarray, "point 3"],
    normal: Float[np.ndarray, "point 3"],
    phase: Float[np.ndarray, "point 2"],
    samples: int = 2,
) -> Float[np.ndarray, "point 3"]:
    """Linear RGB light that falls on the points; `phase` shifts each point's ray pattern."""
    start = position + normal * _LIFT
    total = room.ambient * _openness(room, start, normal, phase, 2 * samples)[:, None]
    for number, light in enumerate(room.lights):
        for sample in range(samples):
            key = number * samples + sample
            shift = (phase + np.array([0.7549 * key, 0.5698 * key], dtype=np.float32)) % 1
            shift[:, 0] = (shift[:, 0] + sample) / samples
            shift = 2 * shift.astype(np.float32) - 1
            target = light.center + shift[:, :1] * light.half_u + shift[:, 1:] * light.half_v
            total += _from_lamp(room, start, normal, target.astype(np.float32), light) / samples
    return total


def _from_lamp(room, start, normal, target, light) -> np.ndarray:
    toward = target - start
    squared = row_dot(toward, toward)
    length = np.sqrt(squared)
    facing = np.maximum(row_dot(toward, normal), 0) / length
    if light.normal.any():
        facing *= np.maximum(-(toward @ light.normal.astype(np.float32)) / length, 0)
    amount = facing / (squared + 0.05)
    lit = np.flatnonzero(amount > 1e-3)
    reach = np.full(len(lit), 0.995, dtype=np.float32)
    shadow = room.blocked(start[lit], toward[lit], reach)
    amount[lit[shadow]] = 0
    return amount[:, None] * np.array(light.power, dtype=np.float32)


def _openness(room, start, normal, phase, samples: int) -> np.ndarray:
    """0..1: the part of the half space above each point that is free nearby."""
    first, second = _tangents(normal)
    free = np.zeros(len(start), dtype=np.float32)
    reach = np.full(len(start), _CORNER_REACH, dtype=np.float32)
    for sample in range(samples):
        turn = 2 * np.pi * ((phase[:, 0] + sample) / samples)
        height = (phase[:, 1] + 0.618 * sample) % 1
        out = np.sqrt(height)
        direction = (
            (out * np.cos(turn))[:, None] * first
            + (out * np.sin(turn))[:, None] * second
            + np.sqrt(1 - height)[:, None] * normal
        ).astype(np.float32)
        # Light from above is brighter than light off the floor.
        free += np.where(room.blocked(start, direction, reach), 0.3, 1.0 + 0.15 * direction[:, 2])
    return free / samples


def _tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that stand on the normals and on each other (Duff et al., JCGT 2017)."""
    x, y, z = normal.T
    sign = np.copysign(np.float32(1), z)
    a = -1 / (sign + z)
    b = x * y * a
    first = np.column_stack([1 + sign * x * x * a, sign * b, -sign * x])
    return first, np.column_stack([b, sign + y * y * a, -y])
