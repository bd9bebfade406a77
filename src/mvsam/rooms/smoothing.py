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

    surface: Float[np.ndarray, "row column 6"]
    light: Float[np.ndarray, "row column channel"]

    def smoothed(self) -> "LightGrid":
        """Averaged over 4 x 4 neighbours, the period of the ray pattern, along surfaces."""
        light = self.light
        for axis in (0, 1):
            light = self._smoothed_along(axis, light)
        return LightGrid(self.surface, light)

    def _smoothed_along(self, axis: int, light: np.ndarray) -> np.ndarray:
        total, weights = light.copy(), np.ones((*light.shape[:2], 1), dtype=np.float32)
        size = light.shape[axis]
        for shift, share in ((-2, 0.5), (-1, 1.0), (1, 1.0), (2, 0.5)):
            here: list[slice] = [slice(None), slice(None)]
            there = list(here)
            here[axis] = slice(max(0, -shift), size - max(0, shift))
            there[axis] = slice(max(0, shift), size - max(0, -shift))
            a, b = tuple(here), tuple(there)
            weight = share * _agreement(self.surface[a], self.surface[b])[..., None]
            total[a] += weight * light[b]
            weights[a] += weight
        return total / weights

    def at(
        self, pixels: Float[np.ndarray, "point 2"], surface: Float[np.ndarray, "point 6"]
    ) -> tuple[Float[np.ndarray, "point channel"], Float[np.ndarray, " point"]]:
        """Light at points seen at (column, row), and how far grid points agree with each (0..1)."""
        rows, columns = self.light.shape[:2]
        table = np.concatenate([self.surface, self.light], axis=2).reshape(rows * columns, -1)
        place = ((pixels - 0.5) / STEP).astype(np.float32)
        place = np.clip(place, 0, np.array([columns - 1.001, rows - 1.001], dtype=np.float32))
        corner = place.astype(np.int32)
        part = place - corner
        total = np.zeros((len(pixels), self.light.shape[2]), dtype=np.float32)
        weights = np.zeros(len(pixels), dtype=np.float32)
        for down in (0, 1):
            for right in (0, 1):
                near = np.abs(1 - right - part[:, 0]) * np.abs(1 - down - part[:, 1]) + 0.02
                rowed = table[(corner[:, 1] + down) * columns + corner[:, 0] + right]
                weight = near * _agreement(surface, rowed[:, :6])
                total += weight[:, None] * rowed[:, 6:]
                weights += weight
        return total / np.maximum(weights, 1e-6)[:, None], weights


def _agreement(asking: np.ndarray, other: np.ndarray) -> np.ndarray:
    """1 for points of one plane with one normal, falling to 0."""
    ax, ay, az, nx, ny, nz = np.moveaxis(asking, -1, 0)
    bx, by, bz, mx, my, mz = np.moveaxis(other, -1, 0)
    off_plane = np.abs((bx - ax) * nx + (by - ay) * ny + (bz - az) * nz)
    facing = nx * mx + ny * my + nz * mz
    return np.clip(1 - off_plane * 40, 0, 1) * np.clip(4 * facing - 3, 0, 1)
