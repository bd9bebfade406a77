"""Pictures of lenses that bend straight lines, resampled to the pinhole of the same matrix."""

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, Shaped
from torch import Tensor


@runtime_checkable
class Lens(Protocol):
    """Anything that bends rays."""

    def bend(self, rays: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape 2"]:
        """Where the lens puts a straight ray, both at z = 1."""
        ...


@dataclass(frozen=True)
class Distortion:
    """What a lens does to a ray (x, y, 1) before the pinhole matrix.

    kind "brown" (OpenCV's and COLMAP's): radial (k1, k2, ...) and tangential (p1, p2).
    kind "fisheye" (OpenCV's): the angle t becomes
    t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8).
    """

    kind: Literal["brown", "fisheye"] = "brown"
    radial: tuple[float, ...] = ()
    tangential: tuple[float, float] = (0.0, 0.0)

    @property
    def is_none(self) -> bool:
        """Whether nothing is bent; a fisheye always bends."""
        coefficients = (*self.radial, *self.tangential)
        return self.kind == "brown" and not any(coefficients)

    def bend(self, rays: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape 2"]:
        """Where the lens puts a straight ray, both at z = 1."""
        x, y = rays[..., 0], rays[..., 1]
        squared = x * x + y * y
        if self.kind == "fisheye":
            radius = np.sqrt(squared)
            angle = np.arctan(radius)
            bent = angle * _series(angle * angle, self.radial)
            return rays * np.where(radius > 1e-8, bent / np.maximum(radius, 1e-8), 1.0)[..., None]
        p1, p2 = self.tangential
        scale = _series(squared, self.radial)
        return np.stack(
            [
                x * scale + 2 * p1 * x * y + p2 * (squared + 2 * x * x),
                y * scale + p1 * (squared + 2 * y * y) + 2 * p2 * x * y,
            ],
            axis=-1,
        )


def _series(t: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    """1 + c1 t + c2 t^2 + ..."""
    total = np.ones_like(t)
    for power, coefficient in enumerate(coefficients, start=1):
        total = total + coefficient * t**power
    return total


def undistort(
    pixels: Shaped[np.ndarray, "height width *channel"],
    intrinsics: Float[np.ndarray, "3 3"],
    lens: Lens,
    outside: int | None = None,
) -> Shaped[np.ndarray, "height width *channel"]:
    """The picture that a pinhole with the same intrinsics (corner convention) would have taken.

    outside: the value of map pixels that the lens did not see, and the sign that the values must
    not be mixed (depth: 0, labels: 255); None: a photo, interpolated, black outside.
    """
    height, width = pixels.shape[:2]
    grid = _grid(height, width, intrinsics, lens)
    is_photo = outside is None
    channels = pixels if pixels.ndim == 3 else pixels[..., None]
    image = torch.from_numpy(channels.astype(np.float64)).permute(2, 0, 1)[None]
    moved = F.grid_sample(
        image - (0 if is_photo else outside),
        grid,
        mode="bilinear" if is_photo else "nearest",
        align_corners=False,
    )[0].permute(1, 2, 0)
    result = moved.numpy() + (0 if is_photo else outside)
    if is_photo:
        result = np.rint(result)
    return result.reshape(pixels.shape).astype(pixels.dtype)


def _grid(height: int, width: int, intrinsics: np.ndarray, lens: Lens) -> Tensor:
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = np.stack([column, row, np.ones_like(row)], axis=-1)
    rays = (pixels @ np.linalg.inv(intrinsics).T)[..., :2]
    bent = lens.bend(rays)
    places = np.concatenate([bent, np.ones_like(bent[..., :1])], axis=-1) @ intrinsics.T
    return torch.from_numpy(2 * places[..., :2] / (width, height) - 1)[None]
