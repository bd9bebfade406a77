"""Light known on a coarse grid of pixels, smoothed along surfaces and read anywhere between.

Grid point (i, j) is the centre of pixel (2 i, 2 j). A neighbour counts only where it lies in the
plane of the asking point and faces the same way, so light does not leak over edges.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

STEP = 2
"""Pixels between grid points."""


@dataclass(frozen=True)
class LightGrid:
    """Rows x columns of surface points (position, unit normal) and the light there."""

    surface: Float[np.ndarray, "6 row column"]
    light: Float[np.ndarray, "channel row column"]

    def smoothed(self) -> "LightGrid":
        """Averaged over 4 x 4 neighbours, the period of the ray pattern, along surfaces."""
        light = self.light
        for axis in (1, 2):
            light = _smoothed_along(axis, light, self.surface)
        return LightGrid(self.surface, light)

    def at(
        self, pixels: Float[np.ndarray, "2 point"], surface: Float[np.ndarray, "6 point"]
    ) -> tuple[Float[np.ndarray, "channel point"], Float[np.ndarray, " point"]]:
        """Light at points seen at (column, row), and how far grid points agree with each (0..1)."""
        channels, rows, columns = self.light.shape
        known = np.concatenate([self.surface, self.light]).reshape(6 + channels, rows * columns)
        column, row = _inside(pixels[0], columns), _inside(pixels[1], rows)
        corner = row.astype(np.int64) * columns + column.astype(np.int64)
        right_part, down_part = column % 1, row % 1
        total = np.zeros((channels, len(corner)), dtype=np.float32)
        weights = np.zeros(len(corner), dtype=np.float32)
        for down in (0, 1):
            for right in (0, 1):
                near = np.abs(1 - right - right_part) * np.abs(1 - down - down_part) + 0.02
                there = known.take(corner + (down * columns + right), axis=1)
                weight = near * _agreement(surface, there[:6])
                total += weight * there[6:]
                weights += weight
        return total / np.maximum(weights, 1e-6), weights


def _smoothed_along(axis: int, light: np.ndarray, surface: np.ndarray) -> np.ndarray:
    total, weights = light.copy(), np.ones((1, *light.shape[1:]), dtype=np.float32)
    size = light.shape[axis]
    for shift, share in ((-2, 0.5), (-1, 1.0), (1, 1.0), (2, 0.5)):
        here = [slice(None)] * 3
        there = list(here)
        here[axis] = slice(max(0, -shift), size - max(0, shift))
        there[axis] = slice(max(0, shift), size - max(0, -shift))
        a, b = tuple(here), tuple(there)
        weight = np.float32(share) * _agreement(surface[a], surface[b])
        total[a] += weight * light[b]
        weights[a] += weight
    return total / weights


def _inside(places: np.ndarray, count: int) -> np.ndarray:
    """Where pixel coordinates lie among `count` grid points, at least a little before the last."""
    return np.clip((places - 0.5) / STEP, 0, count - 1.001).astype(np.float32)


def _agreement(asking: np.ndarray, other: np.ndarray) -> np.ndarray:
    """1 for points of one plane with one normal, falling to 0; each six channels."""
    ax, ay, az, nx, ny, nz = asking
    bx, by, bz, mx, my, mz = other
    off_plane = np.abs((bx - ax) * nx + (by - ay) * ny + (bz - az) * nz)
    facing = nx * mx + ny * my + nz * mz
    return np.clip(1 - off_plane * 40, 0, 1) * np.clip(4 * facing - 3, 0, 1)
