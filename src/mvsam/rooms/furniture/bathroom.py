"""Toilets, washbasins, bathtubs and shower curtains."""

import numpy as np

from .. import materials as m
from ..classes import BATHTUB, CABINET, CLUTTER, SHOWER_CURTAIN, SINK, TOILET
from ..dice import Dice, Number
from ..mesh import Soup, box, cushion, cylinder, loft, rounded_outline, sheet, tapered, tube
from ..room import Piece
from .kitchen import basin, tap
from .storage import fronts, open_carcass


def toilet(dice: Dice) -> Piece:
    """A bowl with seat and lid (shut or up) before a cistern."""
    white = m.ceramic(dice)
    w, seat, back = dice.uniform(0.34, 0.4), dice.uniform(0.38, 0.43), dice.uniform(0.18, 0.22)
    angle = np.linspace(0, 2 * np.pi, 21)[:-1]
    egg = np.column_stack(
        [np.cos(angle) * w / 2 * (1 - 0.12 * np.sin(angle)), np.sin(angle) * 0.24 + 0.02]
    )
    middle = back + 0.24
    foot = dice.uniform(0.5, 0.7)
    bowl = [
        (foot, 0.75, -0.05, 0), (foot, 0.75, -0.05, 0.06), (0.62 * foot + 0.2, 0.72, -0.04, 0.2),
        (0.92, 0.95, 0, 0.33), (1, 1, 0, seat - 0.03),
    ]  # fmt: skip
    shut = dice.chance(0.55)
    inner = [(1, 1, 0, seat - 0.03), (1.03, 1.02, 0, seat), (0.98, 0.98, 0, seat + 0.012)]
    if shut:
        inner += [(0.9, 0.9, 0, seat + 0.03), (0.001, 0.001, 0, seat + 0.034)]
    else:
        inner += [
            (0.68, 0.7, 0, seat + 0.012), (0.62, 0.64, 0, seat - 0.04),
            (0.3, 0.3, 0, seat - 0.16), (0.001, 0.001, 0, seat - 0.18),
        ]  # fmt: skip
    piece = Piece().add(TOILET, white, loft(egg, bowl).moved(y=middle))
    seat_cover = white if dice.chance(0.85) else m.wood(dice)
    piece.add(TOILET, seat_cover, loft(egg, inner).moved(y=middle))
    if not shut:
        lid = loft(
            egg, [(0.001, 0.001, 0, 0), (1, 1, 0, 0), (1, 1, 0, 0.02), (0.001, 0.001, 0, 0.022)]
        )
        piece.add(
            TOILET, seat_cover, lid.moved(y=0.22).turned(98, "x").moved(y=back + 0.02, z=seat)
        )
    high = seat + dice.uniform(0.3, 0.42)
    tank = cushion((-w * 0.56, 0.01, seat - 0.06), (w * 0.56, back, high), 0.12, 7)
    lid = box((-w * 0.58, 0.005, high - 0.03), (w * 0.58, back + 0.012, high))
    button = cylinder(0.02, high, high + 0.008, 10).moved(y=back / 2)
    piece.add(TOILET, white, tank, lid, box((-0.1, 0.06, 0.1), (0.1, back + 0.1, seat - 0.05)))
    return piece.add(TOILET, m.plain(m.METALS[0], 1.5), button)


def washbasin(dice: Dice) -> Piece:
    return dice.pick([_vanity, _vanity, _pedestal, _wall_basin])(dice)


def _vanity(dice: Dice) -> Piece:
    """A cabinet with a basin let into its top."""
    w, d, h = dice.uniform(0.6, 1.2), dice.uniform(0.45, 0.52), dice.uniform(0.78, 0.86)
    shell = m.board(dice)
    piece = Piece()
    open_carcass(piece, CABINET, shell, (-w / 2, 0, 0.08), (w / 2, d - 0.02, h - 0.03), h - 0.22)
    piece.add(CABINET, m.plain(m.BLACK), box((-w / 2, 0, 0), (w / 2, d - 0.06, 0.08)))
    fronts(
        dice,
        piece,
        CABINET,
        shell,
        -w / 2,
        w / 2,
        d - 0.02,
        0.09,
        h - 0.04,
        max(1, round(w / 0.45)),
        1,
    )
    top, sw, sd, y = m.stone(dice) if dice.chance(0.5) else m.ceramic(dice), 0.42, 0.3, d * 0.54
    for low, high in [
        ((-w / 2, 0), (-sw / 2, d)), ((sw / 2, 0), (w / 2, d)),
        ((-sw / 2, 0), (sw / 2, y - sd / 2)), ((-sw / 2, y + sd / 2), (sw / 2, d)),
    ]:  # fmt: skip
        piece.add(SINK, top, box((*low, h - 0.03), (*high, h)))
    piece.place(basin(dice, sw, sd, m.ceramic(dice)), 0, 0, y, h)
    return piece.place(tap(dice), 0, 0, y - sd / 2 - 0.03, h)


def _bowl_outline(w: Number, d: Number) -> list:
    """Straight at the wall, round in front."""
    angle = np.linspace(0, np.pi, 13)
    front = np.column_stack([np.cos(angle) * w / 2, np.sin(angle) * d * 0.6])
    return [*front.tolist(), (-w / 2, -d * 0.4), (w / 2, -d * 0.4)]


def _wall_basin(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.45, 0.62), dice.uniform(0.38, 0.48), dice.uniform(0.8, 0.88)
    white = m.ceramic(dice)
    sections = [
        (0.001, 0.001, -0.05, h - 0.2), (0.35, 0.4, -0.05, h - 0.19), (0.85, 0.85, -0.03, h - 0.1),
        (1, 1, 0, h - 0.03), (1, 1, 0, h), (0.86, 0.84, 0.01, h), (0.78, 0.72, 0.02, h - 0.06),
        (0.4, 0.4, 0.02, h - 0.14), (0.001, 0.001, 0.02, h - 0.15),
    ]  # fmt: skip
    skin = loft(_bowl_outline(w, d), sections).moved(y=0.4 * d)
    return Piece().add(SINK, white, skin).place(tap(dice), 0, 0, 0.05, h)


def _pedestal(dice: Dice) -> Piece:
    piece = _wall_basin(dice)
    column = tapered((-0.09, 0.08, 0), (0.09, 0.26, 0.7), 0.75)
    return piece.add(SINK, m.ceramic(dice), column)


def bathtub(dice: Dice) -> Piece:
    """A tub along the wall with a hollow to look into."""
    w, d, h = dice.uniform(1.45, 1.75), dice.uniform(0.7, 0.8), dice.uniform(0.48, 0.6)
    white = m.ceramic(dice)
    rim = rounded_outline(w, d, 0.03)
    hollow = rounded_outline(w - 0.14, d - 0.14, 0.2)
    piece = Piece()
    apron = white if dice.chance(0.6) else m.wall_tiles(dice)
    for low, high in [
        ((-w / 2, -d / 2), (w / 2, -d / 2 + 0.02)), ((-w / 2, d / 2 - 0.02), (w / 2, d / 2)),
        ((-w / 2, -d / 2), (-w / 2 + 0.02, d / 2)), ((w / 2 - 0.02, -d / 2), (w / 2, d / 2)),
    ]:  # fmt: skip
        piece.add(BATHTUB, apron, box((*low, 0), (*high, h - 0.005)))
    outer, inner = np.array(rim), np.array(hollow)
    ring = np.stack([np.vstack([outer, outer[:1]]), np.vstack([inner, inner[:1]])])
    points = np.concatenate([ring, np.full((*ring.shape[:2], 1), h)], axis=2)
    piece.add(BATHTUB, white, sheet(lambda s, t: points, 2, points.shape[1]))
    sections = [(1, 1, 0, h), (0.97, 0.95, 0, h - 0.04), (0.9, 0.84, 0, 0.16), (0.8, 0.7, 0, 0.1),
                (0.001, 0.001, 0, 0.09)]  # fmt: skip
    piece.add(BATHTUB, white, loft(hollow, sections))
    placed = Piece().place(piece, 0, 0, d / 2)
    spout = tap(dice)
    for soup, _, material in spout.parts:
        placed.add(BATHTUB, material, soup.turned(-90).moved(-w / 2 + 0.05, d / 2, h))
    return placed


def tub_set(dice: Dice) -> Piece:
    """A tub, mostly with a shower curtain along its front."""
    piece = bathtub(dice)
    (left, _, _), (right, front, _) = piece.bounds()
    if dice.chance(0.85):
        piece.place(shower_curtain(dice, right - left), 0, 0, front + 0.075)
    bottles = [dice.uniform(-0.5, 0.5) for _ in range(dice.count(0, 3))]
    for x in bottles:
        shape = cylinder(0.03, 0, dice.uniform(0.12, 0.2), 8)
        material = m.plain(dice.pick(m.BRIGHTS), 0.4)
        piece.add(CLUTTER, material, shape.moved(x, 0.05, _rim(piece)))
    return piece


def _rim(piece: Piece) -> float:
    return max(
        float(s.corners[..., 2].max()) for s, label, _ in piece.parts[:4] if label == BATHTUB
    )


def shower_curtain(dice: Dice, w: Number) -> Piece:
    """A light cloth in folds on a rod, drawn to one side or across."""
    top, low = dice.uniform(1.9, 2.05), dice.uniform(0.1, 0.25)
    color = dice.pick([m.WHITE, m.WHITE, *m.BRIGHTS, *m.FABRICS])
    pattern = dice.pick(["plain", "plain", "stripes", "damask", "plaid", "tiles"])
    second = dice.pick([m.WHITE, *m.BRIGHTS])
    cloth = m.Material(
        pattern, color, second, dice.uniform(0.08, 0.25), 0.8, 0.15, seed=dice.uniform(0, 50)
    )
    share = dice.uniform(0.3, 0.95)
    left = -w / 2 + 0.02 if dice.chance(0.5) else w / 2 - 0.02 - share * w
    piece = Piece().add(
        SHOWER_CURTAIN, cloth, folds(dice, left, left + share * w * 0.98, low, top, 0.035)
    )
    rod = tube([(-w / 2, 0, top + 0.03), (w / 2, 0, top + 0.03)], 0.012)
    piece.add(SHOWER_CURTAIN, m.plain(m.METALS[0], 1.5), rod)
    return piece


def folds(dice: Dice, left: Number, right: Number, low: Number, high: Number, depth: Number):
    """A hanging cloth in vertical waves about y = 0."""
    waves = max(2, round((right - left) / dice.uniform(0.09, 0.16)))
    first, second = dice.uniform(0, 6), dice.uniform(0, 6)

    def shape(s, t):
        turn = 2 * np.pi * waves * s
        flare = 0.5 + 0.5 * t
        y = depth * flare * (np.sin(turn + first) + 0.4 * np.sin(0.37 * turn + second))
        x = left + (right - left) * s + 0.2 * depth * np.cos(turn + first)
        return np.stack([x, y, high - (high - low) * t], axis=2)

    cloth = sheet(shape, 5, waves * 8 + 1)
    flat_uv = np.stack([1.25 * cloth.corners[..., 0], cloth.corners[..., 2]], axis=2)
    return Soup(cloth.corners, cloth.normals, flat_uv)


def towel_rail(dice: Dice) -> Piece:
    w, z = dice.uniform(0.4, 0.6), dice.uniform(1.1, 1.3)
    rail = tube([(-w / 2, 0.05, z), (w / 2, 0.05, z)], 0.01)
    piece = Piece().add(CLUTTER, m.plain(m.METALS[0], 1.5), rail)
    for x in (-w / 2, w / 2):
        piece.add(
            CLUTTER,
            m.plain(m.METALS[0], 1.5),
            box((x - 0.01, 0, z - 0.01), (x + 0.01, 0.06, z + 0.01)),
        )
    towel = m.fabric(dice, dice.pick(m.BRIGHTS + m.FABRICS + [m.WHITE, m.WHITE]))
    return piece.add(
        CLUTTER, towel, cushion((-w * 0.4, 0.03, z - 0.5), (w * 0.4, 0.075, z + 0.02), 0.15, 6)
    )


def paper_holder(dice: Dice) -> Piece:
    roll = cylinder(0.055, -0.06, 0.06, 12).turned(90, "y").moved(y=0.07, z=0.7)
    return Piece().add(CLUTTER, m.plain(m.WHITE), roll)


def washstand_mirror(dice: Dice) -> Piece:
    w, h = dice.uniform(0.45, 0.9), dice.uniform(0.6, 0.9)
    piece = Piece().add(
        CLUTTER, dice.pick([m.metal(dice), m.wood(dice)]), box((-w / 2, 0, 0), (w / 2, 0.02, h))
    )
    face = m.plain(m.srgb(60, 64, 66), 8.0)
    return piece.add(
        CLUTTER, face, box((-w / 2 + 0.02, 0.02, 0.02), (w / 2 - 0.02, 0.022, h - 0.02))
    )
