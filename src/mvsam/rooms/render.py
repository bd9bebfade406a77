"""Pictures of a room: exact depth and labels, and a colour image with light and reflections."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from .light import irradiance
from .room import Hits, Room
from .textures import albedo


@dataclass(frozen=True)
class Camera:
    """A pinhole; intrinsics in pixels with the first pixel's centre at (0.5, 0.5)."""

    intrinsics: Float[np.ndarray, "3 3"]
    world_from_cam: Float[np.ndarray, "4 4"]
    width: int
    height: int

    def rays(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions through (column, row) places; directions have camera z = 1."""
        focal, centre = np.diag(self.intrinsics)[:2], self.intrinsics[:2, 2]
        local = np.column_stack([(pixels - centre) / focal, np.ones(len(pixels))])
        directions = (local @ self.world_from_cam[:3, :3].T).astype(np.float32)
        origins = np.broadcast_to(self.world_from_cam[:3, 3].astype(np.float32), directions.shape)
        return np.ascontiguousarray(origins), directions

    def pixel_centres(self) -> np.ndarray:
        column, row = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.column_stack([column.ravel(), row.ravel()])


@dataclass(frozen=True)
class Rendering:
    """What a perfect camera sees."""

    radiance: Float[np.ndarray, "height width 3"]
    """Linear, before exposure."""
    depth: Float[np.ndarray, "height width"]
    labels: UInt8[np.ndarray, "height width"]


def render(room: Room, camera: Camera) -> Rendering:
    pixels = camera.pixel_centres()
    origins, directions = camera.rays(pixels)
    hits = room.trace(origins, directions)
    shape = camera.height, camera.width
    light = irradiance(room, hits.position, hits.normal, _phase(pixels))
    radiance = surface_color(room, camera, hits, directions) * light
    emission = room.materials.emission[room.material[hits.triangle]]
    radiance += surface_color(room, camera, hits, directions) * emission[:, None]
    return Rendering(
        radiance.reshape(*shape, 3).astype(np.float32),
        hits.distance.reshape(shape),
        room.labels[hits.triangle].reshape(shape),
    )


def surface_color(room: Room, camera: Camera, hits: Hits, directions: np.ndarray) -> np.ndarray:
    footprint = hits.distance / np.float32(camera.intrinsics[0, 0])
    return albedo(room.materials, room.material[hits.triangle], hits.uv, footprint, directions)


def _phase(pixels: np.ndarray) -> np.ndarray:
    """A shift of the ray pattern that differs within each 4 x 4 block of pixels."""
    column, row = (pixels - 0.5).astype(np.int32).T
    index = (column & 3) + 4 * (row & 3)
    order = np.array([0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5])[index]
    return np.column_stack([(order + 0.5) / 16, (order * 0.618) % 1]).astype(np.float32)
