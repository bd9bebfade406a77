"""Light at surface points: lamps and windows with soft shadows, and the dim light of corners.

Each point gets few rays, in a pattern shifted by its `phase`; `smoothing` then averages neighbours
with different phases along surfaces: light varies slowly where paint and grain do not.
"""

import numpy as np
from jaxtyping import Float

from .room import Room, dot

_LIFT = 1e-3
"""Rays start this far off the surface, metres."""
_CORNER_REACH = 0.9
"""Surfaces within this distance take ambient light away, metres."""


def irradiance(
    room: Room,
    position: Float[np.ndarray, "3 point"],
    normal: Float[np.ndarray, "3 point"],
    phase: Float[np.ndarray, "2 point"],
    samples: int = 2,
) -> Float[np.ndarray, "3 point"]:
    """Linear RGB light that falls on the points; `phase` shifts each point's ray pattern."""
    start = position + normal * _LIFT
    total = room.ambient[:, None] * _openness(room, start, normal, phase, 2 * samples)
    for number, light in enumerate(room.lights):
        center, half_u, half_v = np.stack([light.center, light.half_u, light.half_v])[..., None]
        for sample in range(samples):
            key = number * samples + sample
            u, v = (phase + np.array([[0.7549 * key], [0.5698 * key]], dtype=np.float32)) % 1
            right, up = 2 * ((u + sample) / samples) - 1, 2 * v - 1
            target = center + right * half_u + up * half_v
            total += _from_lamp(room, start, normal, target.astype(np.float32), light) / samples
    return total


def _from_lamp(room, start, normal, target, light) -> np.ndarray:
    toward = target - start
    squared = dot(toward, toward)
    length = np.sqrt(squared)
    facing = np.maximum(dot(toward, normal), 0) / length
    if light.normal.any():
        facing *= np.maximum(-(light.normal.astype(np.float32) @ toward) / length, 0)
    amount = facing / (squared + 0.05)
    lit = np.flatnonzero(amount > 1e-3)
    shadow = room.blocked(start.take(lit, axis=1), toward.take(lit, axis=1), 0.995)
    amount[lit[shadow]] = 0
    return np.array(light.power, dtype=np.float32)[:, None] * amount


def _openness(room, start, normal, phase, samples: int) -> np.ndarray:
    """0..1: the part of the half space above each point that is free nearby."""
    first, second = _tangents(normal)
    free = np.zeros(start.shape[1], dtype=np.float32)
    for sample in range(samples):
        turn = 2 * np.pi * ((phase[0] + sample) / samples)
        height = (phase[1] + 0.618 * sample) % 1
        out = np.sqrt(height)
        sideways = (out * np.cos(turn)) * first + (out * np.sin(turn)) * second
        direction = sideways + np.sqrt(1 - height) * normal
        blocked = room.blocked(start, direction, _CORNER_REACH)
        # Light from above is brighter than light off the floor.
        free += np.where(blocked, 0.3, 1.0 + 0.15 * direction[2])
    return free / samples


def _tangents(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors that stand on the normals and on each other (Duff et al., JCGT 2017)."""
    x, y, z = normal
    sign = np.copysign(np.float32(1), z)
    a = -1 / (sign + z)
    b = x * y * a
    first = np.stack([1 + sign * x * x * a, sign * b, -sign * x])
    return first, np.stack([b, sign + y * y * a, -y])
