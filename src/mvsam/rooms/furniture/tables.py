"""Tables and desks, laid with what belongs on them."""

import numpy as np

from .. import materials as m
from ..classes import DESK, TABLE
from ..dice import Dice, Number
from ..mesh import box, cylinder, lathe, prism, rounded_outline, tube
from ..room import Piece
from . import clutter
from .seating import chair, dining_chair, legs, office_chair
from .storage import fronts


def dining_table(dice: Dice) -> Piece:
    return _table(dice, dice.uniform(0.9, 1.8), dice.uniform(0.75, 0.95), dice.uniform(0.71, 0.77))


def coffee_table(dice: Dice) -> Piece:
    return _table(dice, dice.uniform(0.7, 1.2), dice.uniform(0.45, 0.65), dice.uniform(0.36, 0.48))


def side_table(dice: Dice) -> Piece:
    return _table(dice, dice.uniform(0.4, 0.6), dice.uniform(0.4, 0.5), dice.uniform(0.45, 0.6))


def _table(dice: Dice, w: Number, d: Number, h: Number) -> Piece:
    top = m.board(dice)
    under = top if dice.chance(0.6) else m.metal(dice)
    if dice.chance(0.12):
        top = m.plain(m.srgb(190, 205, 205), 2.0)
    thick, piece = dice.uniform(0.02, 0.05), Piece()
    kind = dice.uniform()
    if kind < 0.25:
        d = w = min(w, d * 1.25)
        piece.add(TABLE, top, cylinder(w / 2, h - thick, h, 24).moved(y=d / 2))
        if dice.chance(0.5):
            foot = [(0.001, 0), (0.3 * w, 0), (0.28 * w, 0.03), (0.04, 0.08), (0.04, h - thick)]
            piece.add(TABLE, under, lathe(foot, 14).moved(y=d / 2))
        else:
            for soup in legs(dice, 0.66 * w, 0.66 * d, 0, h - thick, 0.04):
                piece.add(TABLE, under, soup.moved(y=0.17 * d))
    else:
        outline = rounded_outline(w, d, dice.pick([0.005, 0.03, 0.1]))
        piece.add(TABLE, top, prism(outline, h - thick, h).moved(y=d / 2))
        piece.add(TABLE, under, *_understructure(dice, w, d, h - thick))
    spread = (-w / 2 + 0.1, 0.08), (w / 2 - 0.1, d - 0.08)
    return piece.place(clutter.scatter(dice, *spread, h, dice.count(0, 5), clutter.TABLE_THINGS))


def _understructure(dice: Dice, w: Number, d: Number, h: Number) -> list:
    kind = dice.count(0, 2)
    if kind == 0:
        apron = [
            box((-w / 2 + 0.05, y, h - 0.08), (w / 2 - 0.05, y + 0.02, h)) for y in (0.05, d - 0.07)
        ]
        return legs(dice, w - 0.04, d - 0.04, 0, h) + apron
    if kind == 1:
        soups = []
        for x in (-w / 2 + 0.08, w / 2 - 0.08):
            corners = [(x, 0.06, h), (x, 0.06, 0.015), (x, d - 0.06, 0.015), (x, d - 0.06, h)]
            soups += [tube(corners[i : i + 2], 0.016) for i in range(3)]
        return soups
    shelf = box((-w / 2 + 0.06, 0.06, 0.14), (w / 2 - 0.06, d - 0.06, 0.16))
    return [*legs(dice, w - 0.06, d - 0.06, 0, h), shelf]


def dining_set(dice: Dice) -> Piece:
    """A table with chairs around it."""
    piece = dining_table(dice)
    (left, back, _), (right, front, _) = piece.bounds()
    model = dice.pick([dining_chair, dining_chair, chair])
    seed = dice.count(0, 10**6)
    for side in (0, 180):
        count = max(1, int((right - left) / 0.62))
        for i in range(count):
            if dice.chance(0.2):
                continue
            x = left + (right - left) * (i + 0.5) / count
            gap = dice.uniform(-0.2, 0.12)
            y = back - 0.5 - gap if side == 0 else front + 0.5 + gap
            piece.place(model(Dice(seed)), side + dice.uniform(-12, 12), x, y)
    return piece


def desk(dice: Dice) -> Piece:
    """A work table with drawers or bare legs and a computer on it."""
    w, d, h = dice.uniform(1.0, 1.7), dice.uniform(0.55, 0.8), dice.uniform(0.71, 0.77)
    top = m.board(dice)
    piece = Piece().add(DESK, top, box((-w / 2, 0, h - 0.03), (w / 2, d, h)))
    side = top if dice.chance(0.6) else m.metal(dice)
    kind = dice.count(0, 2)
    if kind == 0:
        piece.add(DESK, side, *legs(dice, w - 0.06, d - 0.06, 0, h - 0.03))
    else:
        for x in (-w / 2, w / 2 - 0.03):
            piece.add(DESK, side, box((x, 0.02, 0), (x + 0.03, d - 0.02, h - 0.03)))
        piece.add(DESK, side, box((-w / 2, 0.05, h - 0.4), (w / 2, 0.07, h - 0.03)))
    if kind == 2 or dice.chance(0.4):
        x, wide = dice.pick([-1, 1]) * (w / 2 - 0.26), 0.4
        drawers = Piece().add(
            DESK, side, box((-wide / 2, 0.08, 0.05), (wide / 2, d - 0.04, h - 0.06))
        )
        fronts(
            dice, drawers, DESK, m.board(dice), -wide / 2, wide / 2, d - 0.04, 0.06, h - 0.07, 1, 3
        )
        piece.place(drawers, 0, x)
    return piece.place(_desk_things(dice, w, d, h))


def _desk_things(dice: Dice, w: Number, d: Number, h: Number) -> Piece:
    piece = Piece()
    x = dice.uniform(-0.15, 0.15) * w
    if dice.chance(0.7):
        piece.place(clutter.monitor(dice), dice.uniform(-8, 8), x, 0.06, h)
        piece.place(clutter.keyboard(dice), dice.uniform(-5, 5), x - 0.05, d - 0.3, h)
        if dice.chance(0.3):
            piece.place(clutter.monitor(dice), dice.uniform(-20, -5), x - 0.55, 0.08, h)
    elif dice.chance(0.7):
        piece.place(clutter.laptop(dice), dice.uniform(-15, 15), x, d - 0.4, h)
    if dice.chance(0.4):
        piece.place(clutter.table_lamp(dice), 0, -w / 2 + 0.18, 0.02, h)
    low, high = (x + 0.38, 0.04), (w / 2 - 0.02, d - 0.05)
    if high[0] - low[0] > 0.2:
        piece.place(clutter.scatter(dice, low, high, h, dice.count(1, 4), clutter.TABLE_THINGS))
    return piece


def desk_set(dice: Dice) -> Piece:
    """A desk with a chair in front."""
    piece = desk(dice)
    front = float(piece.bounds()[1, 1])
    seat = office_chair(dice) if dice.chance(0.65) else chair(dice)
    back = float(seat.bounds()[1, 1])
    gap = dice.uniform(-0.12, 0.25)
    return piece.place(
        seat, 180 + dice.uniform(-25, 25), dice.uniform(-0.2, 0.2), front + back + gap
    )


def office_table(dice: Dice) -> Piece:
    """A meeting table with swivel chairs."""
    w, d = dice.uniform(1.4, 2.2), dice.uniform(0.8, 1.1)
    piece = _table(dice, w, d, dice.uniform(0.71, 0.76))
    front = float(piece.bounds()[1, 1])
    seed = dice.count(0, 10**6)
    for x in np.linspace(-w / 3, w / 3, dice.count(1, 3)):
        piece.place(
            office_chair(Dice(seed)), dice.uniform(-20, 20), x, -0.55 - dice.uniform(0, 0.2)
        )
        piece.place(office_chair(Dice(seed)), 180, x, front + 0.55 + dice.uniform(0, 0.2))
    return piece
