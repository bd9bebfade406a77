"""A floor plan that fills up: walls, what is taken, and where a thing still fits."""

import itertools
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from .dice import Dice, Number
from .mesh import Soup, flat, quads
from .room import Piece


@dataclass
class Wall:
    """A straight wall that runs from `start` along `direction` with the room on its left."""

    start: Float[np.ndarray, "2"]
    direction: Float[np.ndarray, "2"]
    length: float
    holes: list[tuple[float, float, float, float]] = field(default_factory=list)
    """(from, to) along the wall and (low, high) in height, metres."""

    @property
    def inward(self) -> Float[np.ndarray, "2"]:
        return np.array([-self.direction[1], self.direction[0]])

    @property
    def angle_deg(self) -> float:
        """Turns a piece's front from +y to the inside of the room."""
        return float(np.degrees(np.arctan2(self.direction[1], self.direction[0])))

    def point(self, along: Number, off: Number = 0.0) -> tuple[float, float]:
        x, y = self.start + along * self.direction + off * self.inward
        return float(x), float(y)

    def surface(self, bottom: Number, top: Number) -> Soup:
        """The wall between two heights, without its holes; uv run along the wall and upwards."""
        xs = sorted({0.0, self.length, *(v for a, b, _, _ in self.holes for v in (a, b))})
        heights = (v for _, _, a, b in self.holes for v in (a, b))
        zs = sorted({bottom, top, *(v for v in heights if bottom < v < top)})
        cells = []
        for a, b in itertools.pairwise(xs):
            for low, high in itertools.pairwise(zs):
                x, z = (a + b) / 2, (low + high) / 2
                if not any(p < x < q and r < z < s for p, q, r, s in self.holes):
                    cells.append([[a, 0, low], [b, 0, low], [b, 0, high], [a, 0, high]])
        soup = flat(quads(np.array(cells)))
        return soup.turned(self.angle_deg).moved(*self.start)


class Plan:
    """The room while it is being furnished."""

    def __init__(self, rectangles: list[tuple[Number, Number, Number, Number]], height: Number):
        self.rectangles = rectangles
        self.height = height
        self.walls = outline_walls(rectangles)
        self.piece = Piece()
        self._taken: list[tuple[np.ndarray, list[float], list[float]]] = []
        """Boxes: their low corner as reserved, and both corners as plain numbers, for speed."""

    def inside(self, low: np.ndarray, high: np.ndarray) -> bool:
        """Whether all four corners of a box stand on the floor."""
        slack = 0.004
        return all(
            any(
                x0 - slack <= x <= x1 + slack and y0 - slack <= y <= y1 + slack
                for x0, y0, x1, y1 in self.rectangles
            )
            for x in (low[0], high[0])
            for y in (low[1], high[1])
        )

    def free(self, low: np.ndarray, high: np.ndarray, over: np.ndarray | None = None) -> bool:
        """Whether a box touches nothing; `over` is the low corner of a reservation to disregard."""
        x0, y0, z0 = (low + 0.01).tolist()
        x1, y1, z1 = (high - 0.01).tolist()
        return not any(
            corner is not over
            and x0 < b[0] and y0 < b[1] and z0 < b[2] and x1 > a[0] and y1 > a[1] and z1 > a[2]
            for corner, a, b in self._taken
        )  # fmt: skip

    def reserve(self, low: np.ndarray, high: np.ndarray) -> None:
        self._taken.append((low, low.tolist(), high.tolist()))

    def put(
        self, thing: Piece, angle_deg: Number, x: Number, y: Number, z: Number = 0.0,
        over: np.ndarray | None = None,
    ) -> bool:  # fmt: skip
        """Place a thing where it is given if it fits there; `over` as in `free`."""
        low, high = thing.bounds(angle_deg) + np.array([x, y, z])
        if not self.inside(low, high) or high[2] > self.height or not self.free(low, high, over):
            return False
        self.reserve(low, high)
        self.piece.place(thing, angle_deg, x, y, z)
        return True

    def at_wall(
        self, dice: Dice, thing: Piece, z: Number = 0.0, gap: Number = 0.01, front: Number = 0.0,
        corner: bool = False, tries: int = 26,
    ) -> "tuple[Wall, float] | None":  # fmt: skip
        """Put a thing's back against some wall; `front` metres before it are kept free.

        Returns the wall and the place along it, or None if there is no room.
        """
        (left, _, _), (right, _, _) = thing.bounds()
        for _ in range(tries):
            wall = self.walls[dice.weighted([w.length for w in self.walls])]
            if wall.length < right - left:
                continue
            low, high = -left + 0.002, wall.length - right - 0.002
            along = dice.pick([low, high]) if corner else dice.uniform(low, high)
            if not corner and dice.chance(0.25):
                along = min(max(along, low), high)
            if self.put(thing, wall.angle_deg, *wall.point(along, gap), z):
                if front:
                    self._keep_free(wall, along + left, along + right, front)
                return wall, along
        return None

    def _keep_free(self, wall: Wall, start: Number, end: Number, depth: Number) -> None:
        ends = np.stack([wall.point(start, 0.02), wall.point(end, depth)])
        low = np.array([*ends.min(axis=0), 0.02])
        self.reserve(low, np.array([*ends.max(axis=0), 1.4]))

    def in_middle(self, dice: Dice, thing: Piece, tries: int = 20, turn: bool = True) -> bool:
        """Put a thing somewhere on the floor, away from the walls if possible."""
        for _ in range(tries):
            x0, y0, x1, y1 = dice.pick(self.rectangles)
            x, y = dice.uniform(x0, x1), dice.uniform(y0, y1)
            angle = dice.pick([0, 90, 180, 270]) + (dice.uniform(-6, 6) if turn else 0.0)
            low, high = thing.bounds()
            middle = (low + high) / 2
            centred = Piece().place(thing, 0, -float(middle[0]), -float(middle[1]))
            if self.put(centred, angle, x, y):
                return True
        return False

    def cut(
        self, dice: Dice, w: Number, low: Number, high: Number, depth: Number, tries: int = 12
    ) -> "tuple[Wall, float, np.ndarray] | None":
        """Cut a hole into a wall and keep `depth` metres before it free.

        Returns the wall, the hole's middle along it and the reservation, or None.
        """
        for _ in range(tries):
            wall = self.walls[dice.weighted([w.length for w in self.walls])]
            if wall.length < w + 0.5:
                continue
            along = dice.uniform(w / 2 + 0.22, wall.length - w / 2 - 0.22)
            ends = np.stack(
                [wall.point(along - w / 2 - 0.1, -0.02), wall.point(along + w / 2 + 0.1, depth)]
            )
            box_low = np.array([*ends.min(axis=0), low])
            box_high = np.array([*ends.max(axis=0), high + 0.05])
            if self.free(box_low, box_high):
                self.reserve(box_low, box_high)
                wall.holes.append((along - w / 2, along + w / 2, low, high))
                return wall, along, box_low
        return None


def outline_walls(rectangles: list[tuple[Number, Number, Number, Number]]) -> list[Wall]:
    """The walls around a union of rectangles that touch but do not overlap."""
    xs = sorted({v for r in rectangles for v in (r[0], r[2])})
    ys = sorted({v for r in rectangles for v in (r[1], r[3])})

    def covered(i: int, j: int) -> bool:
        if not (0 <= i < len(xs) - 1 and 0 <= j < len(ys) - 1):
            return False
        x, y = (xs[i] + xs[i + 1]) / 2, (ys[j] + ys[j + 1]) / 2
        return any(a < x < c and b < y < d for a, b, c, d in rectangles)

    edges = []
    for i in range(len(xs) - 1):
        for j in range(len(ys) - 1):
            if not covered(i, j):
                continue
            a, b = (xs[i], ys[j]), (xs[i + 1], ys[j + 1])
            if not covered(i, j - 1):
                edges.append(((a[0], a[1]), (b[0], a[1])))
            if not covered(i + 1, j):
                edges.append(((b[0], a[1]), (b[0], b[1])))
            if not covered(i, j + 1):
                edges.append(((b[0], b[1]), (a[0], b[1])))
            if not covered(i - 1, j):
                edges.append(((a[0], b[1]), (a[0], a[1])))
    return [_wall(*edge) for edge in _merged(edges)]


def _merged(edges: list) -> list:
    """Edges that continue each other in one line, joined."""
    edges = list(edges)
    changed = True
    while changed:
        changed = False
        for first in edges:
            for second in edges:
                straight = (first[0][0] == first[1][0] == second[1][0]) or (
                    first[0][1] == first[1][1] == second[1][1]
                )
                if first is not second and first[1] == second[0] and straight:
                    edges.remove(first)
                    edges.remove(second)
                    edges.append((first[0], second[1]))
                    changed = True
                    break
            if changed:
                break
    return edges


def _wall(start, end) -> Wall:
    start, end = np.array(start, dtype=np.float64), np.array(end, dtype=np.float64)
    length = float(np.linalg.norm(end - start))
    return Wall(start, (end - start) / length, length)
