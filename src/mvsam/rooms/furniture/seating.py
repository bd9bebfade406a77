"""Chairs, sofas, ottomans and benches."""

import numpy as np

from .. import materials as m
from ..classes import CHAIR, OTHER_FURNITURE, SOFA
from ..dice import Dice, Number
from ..mesh import box, cushion, cylinder, grid_surface, prism, rounded_outline, tapered
from ..room import Piece
from .clutter import pillow


def chair(dice: Dice) -> Piece:
    return dice.pick([dining_chair, dining_chair, office_chair, office_chair, armchair, stool])(
        dice
    )


def legs(dice: Dice, w: Number, d: Number, low: Number, high: Number, splay: Number = 0.0) -> list:
    """Four legs under a w x d top whose back edge is at y = 0; square, round or tapered."""
    thick = dice.uniform(0.022, 0.045)
    kind = dice.count(0, 2)
    soups = []
    for x in (-w / 2 + thick / 2, w / 2 - thick / 2):
        for y in (thick / 2, d - thick / 2):
            if kind == 0:
                leg = box((-thick / 2, -thick / 2, low), (thick / 2, thick / 2, high))
            elif kind == 1:
                leg = cylinder(thick / 2.4, low, high, 8, dice.uniform(1.0, 1.5))
            else:
                half = thick / 1.6
                leg = tapered((-half, -half, low), (half, half, high), 0.55, top=False)
            tilt = np.array([np.sign(x) * splay, np.sign(y - d / 2) * splay])
            shear = np.eye(3)
            shear[:2, 2] = -tilt / max(high - low, 1e-3)
            moved = leg.moved(z=-high).rotated(shear).moved(x, y, high)
            soups.append(moved)
    return soups


def dining_chair(dice: Dice) -> Piece:
    """Four legs, a seat, and a back of slats, bars or one shell."""
    w, d, seat = dice.uniform(0.4, 0.48), dice.uniform(0.4, 0.48), dice.uniform(0.42, 0.48)
    top = seat + dice.uniform(0.35, 0.55)
    frame = dice.pick([m.wood(dice), m.painted(dice), m.metal(dice)])
    cloth = m.fabric(dice) if dice.chance(0.45) else frame
    piece = Piece().add(
        CHAIR, frame, *legs(dice, w, d, 0, seat - 0.02, dice.pick([0.0, 0.0, 0.04]))
    )
    if dice.chance(0.4):
        piece.add(CHAIR, cloth, cushion((-w / 2, 0, seat - 0.05), (w / 2, d, seat + 0.03), 0.3, 6))
    else:
        outline = rounded_outline(w, d, dice.uniform(0.02, 0.1))
        piece.add(CHAIR, cloth, prism(outline, seat - 0.03, seat).moved(y=d / 2))
    back = _chair_back(dice, w, seat, top, frame, cloth)
    lean = dice.uniform(4, 12)
    for soup, label, material in back.parts:
        piece.add(label, material, soup.turned(lean, "x").moved(y=0.035, z=seat - 0.02))
    return _shifted(piece)


def _chair_back(dice: Dice, w: Number, seat: Number, top: Number, frame, cloth) -> Piece:
    """An upright back that stands on z = 0 at y = 0."""
    piece, high = Piece(), top - seat
    kind = dice.count(0, 3)
    if kind == 3:
        return piece.add(CHAIR, cloth, cushion((-w / 2, -0.02, 0.08), (w / 2, 0.03, high), 0.4, 6))
    for x in (-w / 2 + 0.015, w / 2 - 0.015):
        piece.add(CHAIR, frame, box((x - 0.015, -0.015, 0), (x + 0.015, 0.015, high)))
    if kind == 0:
        count = dice.count(3, 6)
        for i in range(count):
            x = (i + 0.5) / count * (w - 0.06) - (w - 0.06) / 2
            piece.add(CHAIR, frame, box((x - 0.011, -0.008, 0), (x + 0.011, 0.008, high - 0.02)))
        piece.add(CHAIR, frame, box((-w / 2, -0.015, high - 0.06), (w / 2, 0.015, high)))
    elif kind == 1:
        for z in np.linspace(0.4, 0.97, dice.count(2, 3)) * high:
            piece.add(CHAIR, frame, box((-w / 2, -0.01, z - 0.06), (w / 2, 0.01, z)))
    else:
        piece.add(CHAIR, cloth, box((-w / 2, -0.012, 0.35 * high), (w / 2, 0.012, high)))
    return piece


def office_chair(dice: Dice) -> Piece:
    """A swivel chair: star foot with castors, gas spring, padded seat and back."""
    cloth = dice.pick([m.fabric(dice), m.leather(dice), m.plain(m.BLACK)])
    foot = dice.pick([m.plain(m.BLACK, 0.3), m.metal(dice)])
    seat, w = dice.uniform(0.44, 0.52), dice.uniform(0.46, 0.52)
    piece = Piece()
    for turn in np.arange(5) * 72 + dice.uniform(0, 72):
        arm = tapered((-0.025, 0, 0.06), (0.025, 0.3, 0.1), 0.7).turned(turn)
        castor = cylinder(0.028, -0.02, 0.02, 8).turned(90, "y").moved(y=0.29, z=0.028).turned(turn)
        piece.add(CHAIR, foot, arm, castor)
    piece.add(CHAIR, foot, cylinder(0.03, 0.08, seat - 0.08, 8))
    piece.add(CHAIR, cloth, cushion((-w / 2, -0.24, seat - 0.09), (w / 2, 0.24, seat), 0.35, 7))
    low, high = seat + dice.uniform(0.06, 0.16), seat + dice.uniform(0.45, 0.75)
    back = cushion((-w * 0.46, -0.05, 0), (w * 0.46, 0.03, high - low), 0.4, 7)
    piece.add(CHAIR, cloth, back.turned(dice.uniform(4, 14), "x").moved(y=-0.24, z=low))
    piece.add(CHAIR, foot, box((-0.035, -0.27, seat - 0.06), (0.035, -0.24, low + 0.2)))
    if dice.chance(0.65):
        for x in (-w / 2 - 0.03, w / 2 + 0.03):
            piece.add(CHAIR, foot, box((x - 0.02, -0.05, seat - 0.06), (x + 0.02, 0, seat + 0.2)))
            pad = box((x - 0.035, -0.15, seat + 0.2), (x + 0.035, 0.12, seat + 0.23))
            piece.add(CHAIR, foot, pad)
    turned = Piece().place(piece, dice.uniform(-35, 35))
    return _shifted(turned)


def armchair(dice: Dice) -> Piece:
    return _couch(dice, CHAIR, dice.uniform(0.7, 0.9), 1)


def stool(dice: Dice) -> Piece:
    seat, r = dice.uniform(0.42, 0.72), dice.uniform(0.15, 0.19)
    frame = dice.pick([m.wood(dice), m.metal(dice)])
    piece = Piece().add(CHAIR, frame, *legs(dice, 1.5 * r, 1.5 * r, 0, seat - 0.02, 0.05))
    top = m.leather(dice) if dice.chance(0.4) else frame
    return _shifted(piece.add(CHAIR, top, cylinder(r, seat - 0.035, seat, 16).moved(y=0.75 * r)))


def sofa(dice: Dice) -> Piece:
    """Two to four seats; at times with a chaise."""
    seats = dice.pick([2, 2, 3, 3, 3, 4])
    return _couch(dice, SOFA, 0.35 + 0.58 * seats * dice.uniform(0.9, 1.1), seats)


def _couch(dice: Dice, label: int, w: Number, seats: int) -> Piece:
    d, seat = dice.uniform(0.78, 0.98), dice.uniform(0.38, 0.46)
    high, arm = seat + dice.uniform(0.32, 0.48), dice.uniform(0.1, 0.24)
    arm_high = seat + dice.uniform(0.1, 0.24)
    cloth = m.leather(dice) if dice.chance(0.3) else m.fabric(dice)
    soft, foot = dice.uniform(0.15, 0.4), dice.uniform(0.04, 0.14)
    base = box((-w / 2 + 0.02, 0.04, foot), (w / 2 - 0.02, d - 0.04, seat - 0.12))
    piece = Piece().add(label, cloth, base)
    dark = m.wood(dice)
    for soup in legs(dice, w - 0.1, d - 0.12, 0, foot + 0.01):
        piece.add(label, dark, soup.moved(y=0.06))
    piece.add(label, cloth, cushion((-w / 2, 0, foot), (w / 2, 0.26, high - 0.04), soft, 8))
    for x in (-w / 2, w / 2 - arm):
        piece.add(label, cloth, cushion((x, 0.02, foot), (x + arm, d, arm_high), soft, 7))
    inner = w - 2 * arm
    piece.add(label, cloth, box((-inner / 2, 0.1, foot), (inner / 2, d - 0.03, seat - 0.1)))
    chaise = dice.chance(0.25) and seats >= 3
    long = dice.uniform(0.4, 0.7) if chaise else 0.0
    for i in range(seats):
        x = -inner / 2 + inner * i / seats
        front = d + (long if i == 0 else 0)
        low = (x, 0.2, seat - 0.14)
        piece.add(
            label, cloth, cushion(low, (x + inner / seats - 0.004, front, seat + 0.01), soft, 7)
        )
        back = cushion(
            (x + 0.01, 0.17, seat - 0.02), (x + inner / seats - 0.01, 0.36, high), 0.45, 7
        )
        piece.add(label, cloth, back)
    if chaise:
        low, end = (-inner / 2, d - 0.1, foot), (-inner / 2 + inner / seats, d + long, seat - 0.1)
        piece.add(label, cloth, box(low, end))
    if dice.chance(0.6):
        for _ in range(dice.count(1, 3)):
            x = dice.uniform(-inner / 2 + 0.2, inner / 2 - 0.2) if seats > 1 else 0.0
            one = Piece()
            for soup, clutter, material in pillow(dice).parts:
                one.add(clutter, material, soup.turned(dice.uniform(15, 30), "x"))
            piece.place(one, dice.uniform(-15, 15), x, 0.46, seat + 0.01)
    if dice.chance(0.2):
        piece.add(label, m.fabric(dice), _throw(dice, high, dice.uniform(-inner / 3, inner / 3)))
    return piece


def _throw(dice: Dice, high: Number, x: Number):
    """A blanket hung over the back."""
    w = dice.uniform(0.35, 0.6)
    y = np.array([-0.012, -0.012, 0.1, 0.28, 0.38, 0.4])
    z = np.array([0.3, high - 0.06, high + 0.012, high + 0.012, high - 0.08, high - 0.3])
    points = np.stack(
        [
            np.broadcast_to(x + np.linspace(-w, w, 5) / 2, (6, 5)),
            *np.broadcast_arrays(y[:, None], z[:, None] + np.zeros((1, 5))),
        ],
        axis=2,
    )
    return grid_surface(points)


def ottoman(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.4, 0.9), dice.uniform(0.4, 0.55), dice.uniform(0.36, 0.46)
    cloth = m.leather(dice) if dice.chance(0.4) else m.fabric(dice)
    piece = Piece().add(OTHER_FURNITURE, m.wood(dice), *legs(dice, w - 0.06, d - 0.06, 0, 0.12))
    piece.add(OTHER_FURNITURE, cloth, box((-w / 2, 0, 0.1), (w / 2, d, h - 0.1)))
    return piece.add(OTHER_FURNITURE, cloth, cushion((-w / 2, 0, h - 0.14), (w / 2, d, h), 0.3, 7))


def bench(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.9, 1.5), dice.uniform(0.3, 0.42), dice.uniform(0.42, 0.48)
    frame = m.wood(dice)
    piece = Piece().add(OTHER_FURNITURE, frame, *legs(dice, w, d, 0, h - 0.03))
    piece.add(OTHER_FURNITURE, frame, box((-w / 2, 0, h - 0.04), (w / 2, d, h)))
    if dice.chance(0.5):
        pad = cushion((-w / 2, 0, h), (w / 2, d, h + 0.06), 0.3, 6)
        piece.add(OTHER_FURNITURE, m.fabric(dice), pad)
    return piece


def _shifted(piece: Piece) -> Piece:
    """Moved so that nothing reaches behind y = 0."""
    return Piece().place(piece, 0, y=-float(piece.bounds()[0, 1]))
