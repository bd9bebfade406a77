"""Beds with bedding."""

import numpy as np

from .. import materials as m
from ..classes import BED, CLUTTER
from ..dice import Dice, Number
from ..mesh import box, cushion, sheet
from ..room import Piece
from .seating import legs
from .storage import nightstand


def bed(dice: Dice) -> Piece:
    """Head at y = 0; pillows are clutter, as in ScanNet."""
    w, d = dice.pick([0.95, 1.0, 1.2, 1.45, 1.6, 1.8]), dice.uniform(1.95, 2.1)
    low, top = dice.uniform(0.18, 0.32), dice.uniform(0.42, 0.58)
    frame = m.fabric(dice) if dice.chance(0.25) else m.board(dice)
    piece = Piece().add(BED, frame, box((-w / 2, 0.04, low - 0.08), (w / 2, d, low + 0.06)))
    piece.add(BED, frame, *legs(dice, w, d, 0, low))
    if dice.chance(0.85):
        head = dice.uniform(0.75, 1.2)
        if dice.chance(0.3):
            piece.add(
                BED, frame, cushion((-w / 2 - 0.02, 0, low), (w / 2 + 0.02, 0.1, head), 0.2, 7)
            )
        else:
            piece.add(BED, frame, box((-w / 2 - 0.02, 0, 0), (w / 2 + 0.02, 0.05, head)))
    if dice.chance(0.3):
        piece.add(
            BED,
            frame,
            box((-w / 2 - 0.01, d, 0), (w / 2 + 0.01, d + 0.04, dice.uniform(0.45, 0.75))),
        )
    white = m.plain(m.vary(dice, m.srgb(228, 226, 220), 0.06))
    piece.add(BED, white, cushion((-w / 2, 0.06, low + 0.04), (w / 2, d - 0.02, top), 0.16, 8))
    linen = m.fabric(dice, dice.pick(m.FABRICS + m.BRIGHTS + [m.WHITE, m.WHITE]))
    piece.add(BED, linen, _duvet(dice, w, d, top, low))
    count = 1 if w < 1.3 else 2
    for i in range(count):
        x = (i + 0.5) / count * w - w / 2
        cover = dice.pick([linen, white, m.fabric(dice)])
        pillow = cushion((-0.3, 0, 0), (0.3, 0.42, 0.15), 0.6, 7).turned(dice.uniform(6, 25), "x")
        size = min(1.0, (w / count - 0.04) / 0.6)
        pillow = pillow.rotated(np.diag([size, 1, 1])).turned(dice.uniform(-8, 8))
        piece.add(CLUTTER, cover, pillow.moved(x, 0.1, top - 0.02))
    return piece


def _duvet(dice: Dice, w: Number, d: Number, top: Number, low: Number):
    """A cover with folds that hangs over the sides."""
    start, drop = dice.uniform(0.3, 0.75), dice.uniform(0.5, 1.0) * (top - low)
    seed = dice.uniform(0, 6)

    def shape(s, t):
        x = (s - 0.5) * (w + 2 * drop)
        over = np.maximum(np.abs(x) - w / 2 - 0.012, 0)
        fold = 0.012 * (np.sin(9 * t + 5 * s + seed) + np.sin(13 * s - 4 * t + 2 * seed))
        hem = 0.012 * np.sin(30 * t + seed) * (over > 0)
        x = np.clip(x, -w / 2 - 0.014, w / 2 + 0.014) + np.sign(x) * hem
        y = start + (d - start) * t
        return np.stack([x, y, top + 0.03 + fold * (over == 0) - over], axis=2)

    return sheet(shape, 16, 22)


def bed_set(dice: Dice) -> Piece:
    """A bed with a nightstand on one or both sides."""
    piece = bed(dice)
    (left, _, _), (right, _, _) = piece.bounds()
    seed = dice.count(0, 10**6)
    for side in (-1, 1):
        if dice.chance(0.65):
            stand = nightstand(Dice(seed))
            half = float(stand.bounds()[1, 0])
            piece.place(stand, 0, (right if side > 0 else left) + side * (half + 0.05), 0.01)
    return piece
