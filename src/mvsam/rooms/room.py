"""A room: all its triangles with labels and materials, its lights, and rays into it."""

from dataclasses import dataclass, field, fields

import numpy as np
from jaxtyping import Float, Int, UInt8

from mvsam.errors import MissingExtraError

from .dice import Number
from .materials import Color, Material
from .mesh import Soup, rotation_about
from .textures import MaterialTable, material_table

Rays = Float[np.ndarray, "3 ray"]
"""Origins or directions."""


@dataclass
class Piece:
    """A thing in its own axes: x across, back at y = 0, front towards +y, z up from the floor."""

    parts: list[tuple[Soup, int, Material]] = field(default_factory=list)
    lights: list["Light"] = field(default_factory=list)

    def add(self, label: int, material: Material, *soups: Soup) -> "Piece":
        self.parts += [(soup, label, material) for soup in soups]
        return self

    def place(self, other: "Piece", angle_deg: Number = 0.0, x=0.0, y=0.0, z=0.0) -> "Piece":
        """Add another piece, turned about z, then moved."""
        moved = [
            (s.turned(angle_deg).moved(x, y, z) if angle_deg else s.moved(x, y, z), label, material)
            for s, label, material in other.parts
        ]
        self.parts += moved
        self.lights += [light.placed(angle_deg, np.array([x, y, z])) for light in other.lights]
        return self

    def bounds(self, angle_deg: Number = 0.0) -> Float[np.ndarray, "2 3"]:
        """(low, high) corner of the box around the piece once it is turned about z."""
        corners = np.concatenate([soup.corners.reshape(-1, 3) for soup, _, _ in self.parts])
        if angle_deg:
            corners = corners @ rotation_about("z", angle_deg).T
        return np.stack([corners.min(axis=0), corners.max(axis=0)])


@dataclass(frozen=True)
class Light:
    """A small glowing parallelogram; with a normal it shines to one side only."""

    center: Float[np.ndarray, "3"]
    half_u: Float[np.ndarray, "3"]
    half_v: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    """Zero for a lamp that shines everywhere."""
    power: Color
    """Irradiance at about one metre, linear RGB; softened nearer to the lamp."""

    def placed(self, angle_deg: Number, offset: Float[np.ndarray, "3"]) -> "Light":
        turn = rotation_about("z", angle_deg)
        return Light(
            turn @ self.center + offset, turn @ self.half_u, turn @ self.half_v,
            turn @ self.normal, self.power,
        )  # fmt: skip


@dataclass(frozen=True)
class Hits:
    """Where rays meet the room, channel by channel: NumPy is far faster along long rows."""

    triangle: Int[np.ndarray, " ray"]
    distance: Float[np.ndarray, " ray"]
    """In lengths of the ray's direction."""
    position: Float[np.ndarray, "3 ray"]
    normal: Float[np.ndarray, "3 ray"]
    """Unit shading normal, towards where the ray came from."""
    uv: Float[np.ndarray, "2 ray"]

    def part(self, chosen: np.ndarray) -> "Hits":
        return Hits(*(getattr(self, f.name).take(chosen, axis=-1) for f in fields(self)))


class Room:
    """Closed and furnished; rays always meet something."""

    def __init__(self, piece: Piece, kind: str, ambient: Color, footprint: np.ndarray):
        materials = list(dict.fromkeys(material for _, _, material in piece.parts))
        number = {material: i for i, material in enumerate(materials)}
        sizes = [len(soup.corners) for soup, _, _ in piece.parts]
        soups = [soup for soup, _, _ in piece.parts]
        self.kind = kind
        self.ambient = np.array(ambient, dtype=np.float32)
        self.lights = piece.lights
        self.footprint: Float[np.ndarray, "rectangle 4"] = footprint
        """x and y of the low and high corners of the rectangles that make up the floor."""
        self.materials: MaterialTable = material_table(materials)
        self.triangles: Float[np.ndarray, "triangle 3 3"] = _stack(soups, "corners")
        self.labels: UInt8[np.ndarray, " triangle"] = np.repeat(
            np.array([label for _, label, _ in piece.parts], dtype=np.uint8), sizes
        )
        self.material = np.repeat([number[m] for _, _, m in piece.parts], sizes)
        self.part = np.repeat(np.arange(len(sizes)), sizes)
        self._shading = _shading_table(soups)
        self._tracer = _build_tracer(self.triangles)

    def trace(self, origins: Rays, directions: Rays) -> Hits:
        """First hits of rays; both sides of a triangle count."""
        result = self._tracer.run(origins.T, directions.T, output=1)
        triangle = result["primID"]
        assert triangle.min() >= 0, "a ray left the room: it is not closed"
        corner, first, second = self._shading.take(triangle, axis=-1)
        shading = corner + result["u"] * first + result["v"] * second
        normal = shading[:3]
        normal /= np.maximum(np.sqrt(dot(normal, normal)), 1e-6)
        normal *= np.where(dot(normal, directions) > 0, np.float32(-1), np.float32(1))
        distance = result["tfar"]
        return Hits(triangle, distance, origins + distance * directions, normal, shading[3:])

    def blocked(self, origins: Rays, directions: Rays, reach: Number) -> np.ndarray:
        """Whether each ray meets anything within `reach` lengths of its direction."""
        lengths = np.full(origins.shape[1], reach, dtype=np.float32)
        return self._tracer.run(origins.T, directions.T, lengths, query="OCCLUDED") >= 0

    def contains(self, positions: Float[np.ndarray, "point 3"]) -> np.ndarray:
        """Whether each place is above the floor."""
        x, y = positions[:, :1], positions[:, 1:2]
        left, front, right, back = self.footprint.T
        return ((x > left) & (x < right) & (y > front) & (y < back)).any(axis=1)

    def nearest(self, origins: Rays, directions: Rays) -> np.ndarray:
        """Distances to the first hits, in lengths of the directions."""
        return self._tracer.run(origins.T, directions.T, query="DISTANCE")


def dot(first: Rays, second: Rays) -> Float[np.ndarray, " ray"]:
    """Dot products, ray by ray."""
    return np.einsum("ij,ij->j", first, second)


def _shading_table(soups: list[Soup]) -> Float[np.ndarray, "3 5 triangle"]:
    """Normal and uv at a triangle's first corner, then how they change towards the others."""
    corners = np.concatenate([_stack(soups, "normals"), _stack(soups, "uv")], axis=2)
    corners[:, 1:] -= corners[:, :1]
    return np.ascontiguousarray(corners.transpose(1, 2, 0))


def _stack(soups: list[Soup], name: str) -> np.ndarray:
    return np.concatenate([getattr(soup, name) for soup in soups]).astype(np.float32)


def _build_tracer(triangles: np.ndarray):
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise MissingExtraError("rooms", "embreex", "rooms") from error
    tracer = EmbreeScene()
    TriangleMesh(tracer, triangles)
    return tracer
