"""Triangle soups and the primitive shapes that all furniture is made of.

Metres, z up. A soup carries, for each triangle's corners, the place, the shading normal and the
texture coordinates (metres on the surface, u along the grain).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from .dice import Number

Corner = Sequence[Number]
"""(x, y, z)."""


@dataclass(frozen=True)
class Soup:
    """Triangles without shared vertices."""

    corners: Float[np.ndarray, "triangle 3 3"]
    normals: Float[np.ndarray, "triangle 3 3"]
    uv: Float[np.ndarray, "triangle 3 2"]

    def moved(self, x: Number = 0.0, y: Number = 0.0, z: Number = 0.0) -> "Soup":
        return Soup(self.corners + np.array([x, y, z]), self.normals, self.uv)

    def rotated(self, rotation: Float[np.ndarray, "3 3"]) -> "Soup":
        return Soup(self.corners @ rotation.T, self.normals @ rotation.T, self.uv)

    def turned(self, angle_deg: Number, axis: str = "z") -> "Soup":
        """Turned about a coordinate axis, counter-clockwise seen from its tip."""
        return self.rotated(rotation_about(axis, angle_deg))


def rotation_about(axis: str, angle_deg: Number) -> Float[np.ndarray, "3 3"]:
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    rotation = np.eye(3)
    rotation[first, first] = rotation[second, second] = cos
    rotation[second, first], rotation[first, second] = sin, -sin
    return rotation


def join(soups: Sequence[Soup]) -> Soup:
    return Soup(
        np.concatenate([s.corners for s in soups]),
        np.concatenate([s.normals for s in soups]),
        np.concatenate([s.uv for s in soups]),
    )


def box_mapped_uv(corners: np.ndarray, grain_axis: int = 0) -> np.ndarray:
    """Texture coordinates read off the two axes each triangle faces least.

    u runs along `grain_axis` wherever that axis lies in the surface.
    """
    return _read_off(corners, _face_normals(corners), grain_axis)


def _face_normals(corners: np.ndarray) -> np.ndarray:
    """Twice as long as the triangles are large; np.cross takes its time over so few numbers."""
    return _cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _cross(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    ax, ay, az = first[..., 0], first[..., 1], first[..., 2]
    bx, by, bz = second[..., 0], second[..., 1], second[..., 2]
    product = np.empty_like(first)
    product[..., 0] = ay * bz - az * by
    product[..., 1] = az * bx - ax * bz
    product[..., 2] = ax * by - ay * bx
    return product


def _lengths(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt((vectors * vectors).sum(axis=-1))


def _read_off(corners: np.ndarray, faces: np.ndarray, grain_axis: int) -> np.ndarray:
    facing = np.abs(faces).argmax(axis=1)
    pairs = np.array([[1, 2], [0, 2], [0, 1]])[facing]
    swap = pairs[:, 1] == grain_axis
    pairs[swap] = pairs[swap][:, ::-1]
    return np.take_along_axis(corners, pairs[:, None, :], axis=2)


def flat(corners: np.ndarray, grain_axis: int = 0) -> Soup:
    """A soup with each triangle's own normal."""
    faces = _face_normals(corners)
    faces /= np.maximum(_lengths(faces), 1e-12)[:, None]
    normals = np.repeat(faces[:, None, :], 3, axis=1)
    return Soup(corners, normals, _read_off(corners, faces, grain_axis))


_CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=np.float64)
_CUBE_FACES = np.array(
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
)


def quads(points: np.ndarray) -> np.ndarray:
    """Triangle corners of (n, 4, 3) quads."""
    return np.concatenate([points[:, [0, 1, 2]], points[:, [0, 2, 3]]])


def box(low: Corner, high: Corner) -> Soup:
    """An axis-aligned box; the grain follows its longest side."""
    points, longest = _box_points(low, high)
    return flat(quads(points[_CUBE_FACES]), longest)


def _box_points(low: Corner, high: Corner) -> tuple[np.ndarray, int]:
    """The eight corners and the number of the longest axis."""
    start, size = np.array(low, dtype=np.float64), np.subtract(high, low, dtype=np.float64)
    return start + _CUBE * size, int(size.argmax())


def tapered(low: Corner, high: Corner, shrink: Number, top: bool = True) -> Soup:
    """A box whose top (or bottom) is shrunk about its centre to `shrink` of its size."""
    points, longest = _box_points(low, high)
    end = _CUBE[:, 2] == (1 if top else 0)
    centre = np.add(low, high)[:2] / 2
    points[end, :2] = centre + (points[end, :2] - centre) * shrink
    return flat(quads(points[_CUBE_FACES]), longest)


def grid_surface(points: Float[np.ndarray, "row column 3"], uv: np.ndarray | None = None) -> Soup:
    """A smooth sheet through a grid of points."""
    normals = _cross(_slopes(points.swapaxes(0, 1)).swapaxes(0, 1), _slopes(points))
    normals /= np.maximum(_lengths(normals), 1e-12)[..., None]
    if uv is None:
        uv = np.zeros((*points.shape[:2], 2))
        uv[:, 1:, 0] = np.cumsum(_lengths(points[:, 1:] - points[:, :-1]), axis=1)
        uv[1:, :, 1] = np.cumsum(_lengths(points[1:] - points[:-1]), axis=0)
    return Soup(_cells(points), _cells(normals), _cells(uv))


def _slopes(points: np.ndarray) -> np.ndarray:
    """np.gradient from row to row; that takes its time over grids as small as a leaf's."""
    slopes = np.empty_like(points)
    slopes[1:-1] = (points[2:] - points[:-2]) / 2
    slopes[0], slopes[-1] = points[1] - points[0], points[-1] - points[-2]
    return slopes


def _cells(grid: np.ndarray) -> np.ndarray:
    """The two triangles of each cell of a (row, column, channel) grid: (triangle, 3, channel)."""
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    corners = np.stack([a, b, c, a, c, d]).reshape(2, 3, -1, grid.shape[2])
    return corners.swapaxes(1, 2).reshape(-1, 3, grid.shape[2])


def lathe(profile: Sequence[tuple[Number, Number]], sides: int = 12, squash: Number = 1.0) -> Soup:
    """A turned shape from (radius, height) pairs, bottom to top; `squash` scales y."""
    radius, height = np.asarray(profile, dtype=np.float64).T
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = np.stack([np.cos(angle), np.sin(angle) * squash], axis=1)
    points = np.empty((len(radius), sides + 1, 3))
    points[..., :2] = radius[:, None, None] * ring
    points[..., 2] = height[:, None]
    slope = np.gradient(radius), np.gradient(height)
    normals = np.empty_like(points)
    normals[..., :2] = slope[1][:, None, None] * np.stack([ring[:, 0], ring[:, 1] / squash], axis=1)
    normals[..., 2] = -slope[0][:, None]
    normals /= np.maximum(_lengths(normals), 1e-12)[..., None]
    u = np.broadcast_to(height[:, None], points.shape[:2])
    v = np.broadcast_to(angle * radius.max(), points.shape[:2])
    return Soup(_cells(points), _cells(normals), _cells(np.stack([u, v], axis=2)))


def cylinder(radius: Number, low: Number, high: Number, sides: int = 10, top: Number = 1.0) -> Soup:
    """An upright closed cylinder about z; the radius at the upper end is `top` times as large."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    side_normals = np.stack([np.column_stack([ring, 0 * angle])] * 2)
    points = np.empty((2, sides + 1, 3))
    points[0, :, :2], points[1, :, :2] = ring * radius, ring * radius * top
    points[0, :, 2], points[1, :, 2] = low, high
    u, v = points[..., 2], np.stack([angle * radius] * 2)
    side = Soup(_cells(points), _cells(side_normals), _cells(np.stack([u, v], axis=2)))
    caps = [_fan(points[1], high), _fan(points[0, ::-1], low)]
    return join([side, flat(np.concatenate(caps))])


def _fan(rim: np.ndarray, height: Number) -> np.ndarray:
    centre = np.broadcast_to(np.array([0.0, 0.0, height]), rim[:-1].shape)
    return np.stack([centre, rim[:-1], rim[1:]], axis=1)


def prism(outline: Sequence[tuple[Number, Number]], low: Number, high: Number) -> Soup:
    """A convex (x, y) outline, counter-clockwise, extruded upwards."""
    points = np.asarray(outline, dtype=np.float64)
    lower = np.column_stack([points, np.full(len(points), low)])
    upper = np.column_stack([points, np.full(len(points), high)])
    following = np.roll(np.arange(len(points)), -1)
    sides = np.stack([lower, lower[following], upper[following], upper], axis=1)
    fan = [[0, i, i + 1] for i in range(1, len(points) - 1)]
    caps = np.concatenate([upper[fan], lower[fan][:, ::-1]])
    return flat(np.concatenate([quads(sides), caps]))


def rounded_outline(width: Number, depth: Number, radius: Number, steps: int = 4) -> list:
    """A rectangle about the origin with round corners, counter-clockwise."""
    points = []
    for quarter, (x, y) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        for step in range(steps + 1):
            angle = (quarter + step / steps) * np.pi / 2
            points.append(
                (
                    x * (width / 2 - radius) + radius * np.cos(angle),
                    y * (depth / 2 - radius) + radius * np.sin(angle),
                )
            )
    return points


def cushion(low: Corner, high: Corner, softness: Number = 0.35, rings: int = 8) -> Soup:
    """A soft box: a superellipsoid that fills the bounds; softness 1 is an ellipsoid."""
    centre, half = np.add(low, high) / 2, np.subtract(high, low) / 2
    tilt = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)[:, None]
    turn = np.linspace(-np.pi, np.pi, 2 * rings + 1)[None, :]
    # A soft box is flat on most of its faces, so the samples crowd where it bends.
    tilt = tilt - np.sin(4 * tilt) / 4 * (1 - softness) * 0.8
    turn = turn - np.sin(4 * turn) / 4 * (1 - softness) * 0.8

    def power(value, exponent):
        return np.sign(value) * np.abs(value) ** exponent

    def surface(exponent):
        return np.stack(
            [
                power(np.cos(tilt), exponent) * power(np.cos(turn), exponent),
                power(np.cos(tilt), exponent) * power(np.sin(turn), exponent),
                power(np.sin(tilt), exponent) + 0 * turn,
            ],
            axis=2,
        )

    points = centre + surface(softness) * half
    normals = surface(2 - softness) / np.maximum(half, 1e-6)
    normals /= np.maximum(_lengths(normals), 1e-12)[..., None]
    corners = _cells(points)
    keep = _lengths(_face_normals(corners)) > 1e-10
    return Soup(corners[keep], _cells(normals)[keep], box_mapped_uv(corners[keep]))


def tube(path: Sequence[Sequence[Number]], radius: Number, sides: int = 6) -> Soup:
    """A round bar along a polyline, as chair frames, rods and taps are."""
    points = np.asarray(path, dtype=np.float64)
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    helper = np.eye(3)[np.abs(along.mean(axis=0)).argmin()]
    first = np.cross(along, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(along, first)
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    round_normals = (
        np.cos(angle)[None, :, None] * first[:, None]
        + np.sin(angle)[None, :, None] * second[:, None]
    )
    ring = points[:, None] + radius * round_normals
    length = np.pad(np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)), (1, 0))
    u = np.broadcast_to(length[:, None], ring.shape[:2])
    v = np.broadcast_to(angle * radius, ring.shape[:2])
    return Soup(_cells(ring), _cells(round_normals), _cells(np.stack([u, v], axis=2)))


def sheet(shape: Callable[[np.ndarray, np.ndarray], np.ndarray], rows: int, columns: int) -> Soup:
    """A smooth sheet: `shape(s, t)` gives points for s across and t down, both in [0, 1]."""
    s, t = np.meshgrid(np.linspace(0, 1, columns), np.linspace(0, 1, rows))
    return grid_surface(shape(s, t))


def loft(
    outline: Sequence[Sequence[Number]] | np.ndarray,
    sections: Sequence[tuple[Number, Number, Number, Number]],
) -> Soup:
    """A skin over copies of a closed (x, y) outline; a section is (x scale, y scale, y shift, z).

    Ends open unless the first or last section is scaled to nothing.
    """
    closed = np.asarray([*outline, outline[0]], dtype=np.float64)
    points = np.empty((len(sections), len(closed), 3))
    for row, (scale_x, scale_y, shift, height) in enumerate(sections):
        points[row] = np.column_stack(
            [closed[:, 0] * scale_x, closed[:, 1] * scale_y + shift, np.full(len(closed), height)]
        )
    skin = grid_surface(points)
    keep = _lengths(_face_normals(skin.corners)) > 1e-9
    return Soup(skin.corners[keep], skin.normals[keep], skin.uv[keep])
