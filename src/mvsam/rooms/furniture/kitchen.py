"""Kitchen runs: base cabinets, worktop, sink, stove, cabinets above."""

import itertools

import numpy as np

from .. import materials as m
from ..classes import CABINET, CLUTTER, COUNTER, SINK, WALL
from ..dice import Dice, Number
from ..mesh import box, cylinder, loft, rounded_outline, sheet, tube
from ..room import Piece
from . import clutter
from .storage import fronts, open_carcass, wall_cabinet

DEPTH = 0.62


def kitchen_run(dice: Dice, w: Number, upper: bool = True) -> Piece:
    """A worktop of width `w` against the wall with what belongs below, on and above it."""
    h, top = dice.uniform(0.86, 0.92), m.stone(dice) if dice.chance(0.75) else m.wood(dice)
    shell = m.board(dice)
    piece = Piece()
    open_carcass(piece, CABINET, shell, (-w / 2, 0, 0.1), (w / 2, DEPTH - 0.06, h - 0.04), h - 0.22)
    piece.add(CABINET, m.plain(m.BLACK), box((-w / 2, 0, 0), (w / 2, DEPTH - 0.12, 0.1)))
    stove_x = dice.uniform(w / 2 - 0.65, w / 2 - 0.35) if w > 1.9 and dice.chance(0.75) else None
    right = w / 2 if stove_x is None else stove_x - 0.3
    columns = max(1, round((right + w / 2) / 0.5))
    for left, end, rows in _splits(dice, -w / 2, right, columns):
        fronts(dice, piece, CABINET, shell, left, end, DEPTH - 0.06, 0.11, h - 0.05, 1, rows)
    if stove_x is not None:
        piece.place(_stove(dice, h), 0, stove_x)
        fronts(
            dice, piece, CABINET, shell, stove_x + 0.3, w / 2, DEPTH - 0.06, 0.11, h - 0.05, 1, 1
        )
    sink_x = dice.uniform(-w / 2 + 0.5, right - 0.5) if right + w / 2 > 1.0 else (right - w / 2) / 2
    _worktop(dice, piece, top, w, h, sink_x)
    if dice.chance(0.7):
        tiles = m.wall_tiles(dice) if dice.chance(0.7) else top
        piece.add(WALL, tiles, box((-w / 2, 0, h), (w / 2, 0.012, h + 0.52)))
    if upper:
        _hang_cabinets(dice, piece, w, h + 0.55, stove_x)
    for low, high in ((-w / 2 + 0.05, sink_x - 0.32), (sink_x + 0.32, right - 0.05)):
        if high - low > 0.25:
            piece.place(_worktop_things(dice, low, high, h))
    return piece


def _splits(dice: Dice, left: Number, right: Number, columns: int):
    edges = np.linspace(left, right, columns + 1)
    return [(a, b, dice.pick([1, 1, 3])) for a, b in itertools.pairwise(edges)]


def _worktop(dice: Dice, piece: Piece, top: m.Material, w: Number, h: Number, x: Number) -> None:
    """The slab with a hole for the sink."""
    sw, sd, y = 0.5, 0.38, 0.32
    slab = (h - 0.04, h)
    d = DEPTH + 0.01
    for low, high in [
        ((-w / 2, 0), (x - sw / 2, d)), ((x + sw / 2, 0), (w / 2, d)),
        ((x - sw / 2, 0), (x + sw / 2, y - sd / 2)), ((x - sw / 2, y + sd / 2), (x + sw / 2, d)),
    ]:  # fmt: skip
        piece.add(COUNTER, top, box((*low, slab[0]), (*high, slab[1])))
    piece.place(basin(dice, sw, sd), 0, x, y, h)
    piece.place(tap(dice), 0, x, y - sd / 2 - 0.04, h)


def basin(dice: Dice, w: Number, d: Number, material: m.Material | None = None) -> Piece:
    """A sunk bowl about the origin, rim at z = 0, as deep as a kitchen sink."""
    steel = material or dice.pick(
        [m.plain(m.METALS[0], 1.5), m.plain(m.METALS[0], 1.0), m.ceramic(dice)]
    )
    outline = rounded_outline(w, d, 0.06)
    sections = [
        (1.06, 1.08, 0, 0.002), (1.06, 1.08, 0, 0.008), (0.97, 0.97, 0, 0.008),
        (0.95, 0.94, 0, -0.02), (0.9, 0.88, 0, -0.15), (0.7, 0.65, 0, -0.17),
        (0.001, 0.001, 0, -0.175),
    ]  # fmt: skip
    drain = cylinder(0.03, -0.176, -0.172, 10)
    return Piece().add(SINK, steel, loft(outline, sections)).add(SINK, m.plain(m.METALS[1]), drain)


def tap(dice: Dice) -> Piece:
    """A bent pipe over the basin, towards +y."""
    high, out = dice.uniform(0.12, 0.32), dice.uniform(0.12, 0.2)
    steps = np.linspace(0, np.pi, 6)
    bend = [(0, out / 2 * (1 - np.cos(a)), high + out / 3 * np.sin(a)) for a in steps]
    path = [(0, 0, 0), *bend, (0, out, high - 0.04)]
    chrome = m.plain(m.METALS[0], 2.0)
    piece = Piece().add(SINK, chrome, tube(path, 0.012), cylinder(0.025, 0, 0.03, 10))
    return piece.add(SINK, chrome, box((0.02, -0.008, 0.03), (0.08, 0.008, 0.045)))


def _stove(dice: Dice, h: Number) -> Piece:
    skin = m.plain(dice.pick([m.WHITE, m.METALS[0], m.BLACK]), 0.6)
    piece = Piece().add(CLUTTER, skin, box((-0.3, 0.05, 0.08), (0.3, DEPTH, h - 0.01)))
    piece.add(CLUTTER, m.plain(m.BLACK, 1.2), box((-0.24, DEPTH, 0.25), (0.24, DEPTH + 0.01, 0.62)))
    rail = tube([(-0.25, DEPTH + 0.04, 0.68), (0.25, DEPTH + 0.04, 0.68)], 0.012)
    piece.add(CLUTTER, m.plain(m.METALS[0], 1.5), rail)
    piece.add(
        CLUTTER, m.plain(m.BLACK, 1.0), box((-0.29, 0.04, h), (0.29, DEPTH - 0.02, h + 0.008))
    )
    ring = m.plain(m.METALS[2], 0.4)
    for x in (-0.14, 0.14):
        for y in (0.18, 0.44):
            piece.add(CLUTTER, ring, cylinder(dice.pick([0.07, 0.09]), h, h + 0.02, 14).moved(x, y))
    for x in np.linspace(-0.24, 0.24, 5):
        knob = cylinder(0.02, 0, 0.03, 8).turned(-90, "x").moved(x, DEPTH, h - 0.07)
        piece.add(CLUTTER, m.plain(m.METALS[1]), knob)
    if dice.chance(0.4):
        pot = cylinder(0.1, h + 0.02, h + dice.uniform(0.1, 0.18), 16).moved(-0.14, 0.44)
        piece.add(CLUTTER, m.plain(dice.pick([m.METALS[0], *m.BRIGHTS]), 1.0), pot)
    return piece


def _hang_cabinets(dice: Dice, piece: Piece, w: Number, z: Number, stove_x: Number | None) -> None:
    seed = dice.count(0, 10**6)
    spans = (
        [(-w / 2, w / 2)]
        if stove_x is None
        else [(-w / 2, stove_x - 0.32), (stove_x + 0.32, w / 2)]
    )
    for left, right in spans:
        left += dice.pick([0.0, 0.0, 0.4]) if right - left > 1.2 else 0.0
        if right - left > 0.28:
            piece.place(wall_cabinet(Dice(seed), right - left), 0, (left + right) / 2, 0, z)
    if stove_x is not None:
        hood = m.plain(m.METALS[0], 1.2)
        piece.add(CLUTTER, hood, box((stove_x - 0.3, 0, z + 0.05), (stove_x + 0.3, 0.45, z + 0.13)))
        piece.add(
            CLUTTER, hood, box((stove_x - 0.13, 0, z + 0.13), (stove_x + 0.13, 0.25, z + 0.6))
        )


def _worktop_things(dice: Dice, left: Number, right: Number, h: Number) -> Piece:
    things = (*clutter.TABLE_THINGS, clutter.bottle, clutter.bottle)
    piece = Piece()
    if right - left > 0.6 and dice.chance(0.45):
        piece.place(_microwave(dice), 0, left + 0.3, 0.06, h)
        left += 0.58
    area = (left, 0.05), (right, DEPTH - 0.1)
    return piece.place(clutter.scatter(dice, *area, h, dice.count(1, 5), things))


def _microwave(dice: Dice) -> Piece:
    skin = m.plain(dice.pick([m.WHITE, m.METALS[0], m.BLACK]), 0.5)
    piece = Piece().add(CLUTTER, skin, box((-0.25, 0, 0), (0.25, 0.34, 0.28)))
    piece.add(CLUTTER, m.plain(m.BLACK, 1.3), box((-0.23, 0.34, 0.03), (0.12, 0.346, 0.25)))
    buttons = sheet(
        lambda s, t: np.stack([0.15 + 0.08 * s, 0.342 + 0 * s, 0.05 + 0.18 * t], 2), 2, 2
    )
    return piece.add(CLUTTER, m.Material("tiles", m.METALS[1], m.BLACK, 0.025), buttons)
