"""Temporary first furniture: boxes of every class along the walls."""

import numpy as np

from . import materials as m
from .dice import Dice
from .mesh import box
from .room import Light, Piece, Room

SIZES = {
    2: (0.9, 0.5, 1.2), 3: (1.5, 2.0, 0.5), 4: (0.5, 0.5, 0.85), 5: (1.8, 0.8, 0.7), 6: (1.2, 0.8, 0.7),
    7: (0.9, 0.05, 2.0), 8: (1.2, 0.05, 1.0), 9: (0.9, 0.3, 1.8), 10: (0.6, 0.03, 0.5), 11: (1.5, 0.6, 0.9),
    12: (1.4, 0.7, 0.75), 13: (0.8, 0.1, 2.0), 14: (0.7, 0.7, 1.7), 15: (1.2, 0.05, 1.9), 16: (0.4, 0.6, 0.75),
    17: (0.5, 0.4, 0.85), 18: (1.6, 0.75, 0.55), 19: (0.5, 0.5, 0.45),
}  # fmt: skip


def build_room(dice: Dice) -> Room:
    width, length, height = dice.uniform(2.8, 6), dice.uniform(2.8, 6), dice.uniform(2.3, 3)
    piece = Piece()
    paint = m.wall_paint(dice)
    piece.add(1, m.floor(dice), box((0, 0, -0.1), (width, length, 0)))
    piece.add(255, m.plain(m.WHITE), box((0, 0, height), (width, length, height + 0.1)))
    for low, high in [
        ((-0.1, 0, 0), (0, length, height)), ((width, 0, 0), (width + 0.1, length, height)),
        ((0, -0.1, 0), (width, 0, height)), ((0, length, 0), (width, length + 0.1, height)),
    ]:  # fmt: skip
        piece.add(0, paint, box(low, high))
    taken = []
    for _ in range(60):
        label = dice.pick(list(SIZES))
        w, d, h = SIZES[label]
        side = dice.count(0, 3)
        x, y = dice.uniform(w / 2, max(w / 2, width - w / 2)), dice.uniform(w / 2, max(w / 2, length - w / 2))
        x, y, angle = [(x, 0, 0), (x, length, 180), (0, y, -90), (width, y, 90)][side]
        z = {10: 1.2, 8: 0.9}.get(label, 0)
        thing = Piece().place(Piece().add(label, m.board(dice), box((-w / 2, 0, z), (w / 2, d, z + h))), angle, x, y)
        low, high = thing.bounds()
        if (low[:2] < -0.01).any() or high[0] > width + 0.01 or high[1] > length + 0.01:
            continue
        if any((low < b - 0.02).all() and (high > a + 0.02).all() for a, b in taken):
            continue
        taken.append((low, high))
        piece.place(thing)
    piece.lights.append(Light(np.array([width / 2, length / 2, height - 0.1]), np.array([0.2, 0, 0]),
                              np.array([0, 0.2, 0]), np.array([0, 0, -1.0]), (3.0, 2.8, 2.5)))  # fmt: skip
    return Room(piece, "mixed", (0.5, 0.5, 0.5), np.array([[0, 0, width, length]]))
