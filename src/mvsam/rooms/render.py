"""Pictures of a room: exact depth and labels, and a colour image with light and reflections."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from .light import irradiance
from .room import Hits, Rays, Room, dot
from .smoothing import STEP, LightGrid
from .textures import albedo

_EDGE_SAMPLES = np.array([[-0.31, 0.28, 0.06], [-0.17, -0.26, 0.33]])
"""Extra rays through a pixel on an edge, besides the one through its centre: columns and rows."""


Pixels = Float[np.ndarray, "2 pixel"]
"""Column and row of places in an image."""


@dataclass(frozen=True)
class Camera:
    """A pinhole; intrinsics in pixels with the first pixel's centre at (0.5, 0.5)."""

    intrinsics: Float[np.ndarray, "3 3"]
    world_from_cam: Float[np.ndarray, "4 4"]
    width: int
    height: int

    def rays(self, pixels: Pixels) -> tuple[Rays, Rays]:
        """Origins and directions through some places; directions have camera z = 1."""
        focal, centre = np.diag(self.intrinsics)[:2, None], self.intrinsics[:2, 2:]
        local = np.concatenate([(pixels - centre) / focal, np.ones((1, pixels.shape[1]))])
        directions = (self.world_from_cam[:3, :3] @ local).astype(np.float32)
        origin = self.world_from_cam[:3, 3:].astype(np.float32)
        return np.broadcast_to(origin, directions.shape), directions

    def pixel_centres(self) -> Pixels:
        column, row = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([column.ravel(), row.ravel()])


@dataclass(frozen=True)
class Rendering:
    """What a perfect camera sees."""

    radiance: Float[np.ndarray, "height width 3"]
    """Linear, before exposure."""
    depth: Float[np.ndarray, "height width"]
    """Of the ray through each pixel's centre, metres along the optical axis."""
    labels: UInt8[np.ndarray, "height width"]


@dataclass(frozen=True)
class _Seen:
    """Points of the room seen through places of the image."""

    pixels: Pixels
    directions: Rays
    hits: Hits

    @property
    def surface(self) -> np.ndarray:
        return np.concatenate([self.hits.position, self.hits.normal])

    def part(self, chosen: np.ndarray) -> "_Seen":
        return _Seen(
            self.pixels.take(chosen, axis=1),
            self.directions.take(chosen, axis=1),
            self.hits.part(chosen),
        )


def render(room: Room, camera: Camera) -> Rendering:
    centres = _see(room, camera, camera.pixel_centres())
    shape = camera.height, camera.width
    grid = _light_grid(room, camera, centres)
    radiance = _radiance(room, camera, grid, centres)
    edges = np.flatnonzero(_on_edge(room.part[centres.hits.triangle].reshape(shape)))
    if len(edges):
        around = centres.pixels[:, None, edges] + _EDGE_SAMPLES[..., None]
        extra = _radiance(room, camera, grid, _see(room, camera, around.reshape(2, -1)))
        extra = np.minimum(extra, 8.0).reshape(3, -1, len(edges)).sum(axis=1)
        centre = np.minimum(radiance[:, edges], 8.0)
        radiance[:, edges] = (centre + extra) / (1 + _EDGE_SAMPLES.shape[1])
    return Rendering(
        np.ascontiguousarray(radiance.T).reshape(*shape, 3),
        centres.hits.distance.reshape(shape),
        room.labels[centres.hits.triangle].reshape(shape),
    )


def _see(room: Room, camera: Camera, pixels: Pixels) -> _Seen:
    origins, directions = camera.rays(pixels)
    return _Seen(pixels, directions, room.trace(origins, directions))


def _on_edge(parts: np.ndarray) -> np.ndarray:
    """Pixels beside a pixel that shows another part."""
    edge = np.zeros(parts.shape, dtype=bool)
    across, down = parts[:, 1:] != parts[:, :-1], parts[1:] != parts[:-1]
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= down
    edge[:-1] |= down
    return edge


def _light_grid(room: Room, camera: Camera, centres: _Seen) -> LightGrid:
    index = np.arange(camera.height * camera.width).reshape(camera.height, camera.width)
    index = index[::STEP, ::STEP]
    coarse = centres.part(index.ravel())
    light = _incoming(room, camera, coarse, samples=2)
    surface = coarse.surface.reshape(6, *index.shape)
    return LightGrid(surface, light.reshape(6, *index.shape)).smoothed()


def _incoming(room: Room, camera: Camera, seen: _Seen, samples: int) -> np.ndarray:
    """Light that falls on each point, and the light it would mirror: six channels."""
    phase = _phase(seen.pixels)
    light = irradiance(room, seen.hits.position, seen.hits.normal, phase, samples)
    mirrored = np.zeros_like(light)
    shiny = np.flatnonzero(room.materials.gloss[room.material[seen.hits.triangle]] > 0.1)
    if len(shiny):
        mirrored[:, shiny] = _mirrored(room, camera, seen.part(shiny), phase.take(shiny, axis=1))
    return np.concatenate([light, mirrored])


def _mirrored(room: Room, camera: Camera, seen: _Seen, phase: np.ndarray) -> np.ndarray:
    normal = seen.hits.normal
    direction = seen.directions - 2 * dot(seen.directions, normal) * normal
    direction /= np.sqrt(dot(direction, direction))
    # A polished floor is not a mirror: the pattern of shifts is blurred with the rest.
    direction[:2] += 0.05 * (phase - 0.5)
    start = seen.hits.position + normal * np.float32(2e-3)
    hits = room.trace(start, direction)
    color = _albedo(room, camera, hits, direction, seen.hits.distance + hits.distance)
    light = irradiance(room, hits.position, hits.normal, phase, samples=1)
    emission = room.materials.emission[room.material[hits.triangle]]
    return np.minimum(color * (light + emission), 6.0)


def _radiance(room: Room, camera: Camera, grid: LightGrid, seen: _Seen) -> np.ndarray:
    """Linear light from each seen point to the camera."""
    incoming, agreement = grid.at(seen.pixels, seen.surface)
    lonely = np.flatnonzero(agreement < 1e-3)
    if len(lonely):
        incoming[:, lonely] = _incoming(room, camera, seen.part(lonely), samples=2)
    material = room.material[seen.hits.triangle]
    color = _albedo(room, camera, seen.hits, seen.directions, seen.hits.distance)
    share = _mirror_share(room.materials.gloss[material], seen)
    body = color * (incoming[:3] * (1 - share) + room.materials.emission[material])
    return (body + share * incoming[3:]).astype(np.float32)


def _mirror_share(gloss: np.ndarray, seen: _Seen) -> np.ndarray:
    """Schlick's rule for varnish, stronger for metal (gloss above 1)."""
    facing = -dot(seen.directions, seen.hits.normal)
    facing /= np.sqrt(dot(seen.directions, seen.directions))
    fresnel = 0.04 + 0.96 * (1 - np.clip(facing, 0, 1)) ** 5
    return np.minimum(gloss * fresnel, np.where(gloss > 4, 0.85, 0.5))


def _albedo(room: Room, camera: Camera, hits: Hits, directions, path: np.ndarray) -> np.ndarray:
    footprint = path / np.float32(camera.intrinsics[0, 0])
    return albedo(room.materials, room.material[hits.triangle], hits.uv, footprint, directions)


def _phase(pixels: Pixels) -> np.ndarray:
    """A shift of the ray pattern that differs within each 4 x 4 block of the light grid."""
    column, row = (pixels / STEP).astype(np.int32)
    index = (column & 3) + 4 * (row & 3)
    order = np.array([0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5])[index]
    return np.stack([(order + 0.5) / 16, (order * 0.618) % 1]).astype(np.float32)
