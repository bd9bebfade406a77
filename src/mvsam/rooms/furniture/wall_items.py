"""What is set into walls or hangs on them: doors, windows, curtains, pictures."""

import numpy as np

from .. import materials as m
from ..classes import CLUTTER, CURTAIN, DOOR, FLOOR, PICTURE, WALL, WINDOW
from ..dice import Dice, Number
from ..mesh import Soup, box, cushion, cylinder, sheet, tube
from ..room import Light, Piece
from .bathroom import folds


def door(dice: Dice, w: Number, h: Number, floor: m.Material, paint: m.Material) -> Piece:
    """Fills a hole w x h in a wall from y = 0 backwards; open ones show a dim hallway."""
    leaf_material = dice.pick([m.wood(dice), m.wood(dice), m.painted(dice), m.plain(m.WHITE, 0.3)])
    trim = m.plain(m.WHITE, 0.2) if dice.chance(0.5) else leaf_material
    piece = Piece()
    for x in (-w / 2 - 0.07, w / 2):
        piece.add(DOOR, trim, box((x, -0.02, 0), (x + 0.07, 0.018, h + 0.07)))
    piece.add(DOOR, trim, box((-w / 2, -0.02, h), (w / 2, 0.018, h + 0.07)))
    for x in (-w / 2 - 0.01, w / 2 - 0.01):
        piece.add(DOOR, trim, box((x, -0.15, 0), (x + 0.02, 0, h)))
    piece.add(DOOR, trim, box((-w / 2, -0.15, h - 0.01), (w / 2, 0, h + 0.01)))
    piece.add(FLOOR, floor, box((-w / 2 - 0.05, -0.2, -0.05), (w / 2 + 0.05, 0.01, 0)))
    leaf = _leaf(dice, w - 0.03, h - 0.02, leaf_material)
    opening = dice.uniform(20, 100) if dice.chance(0.3) else 0.0
    if opening:
        piece.place(_hallway(w, h, floor, paint))
        hinged = Piece().place(leaf, 0, w / 2 - 0.015)
        return piece.place(hinged, opening, -w / 2 + 0.015, 0.01)
    back = box((-w / 2 - 0.05, -0.17, -0.05), (w / 2 + 0.05, -0.15, h + 0.05))
    return piece.add(DOOR, leaf_material, back).place(leaf, 0, 0, -dice.uniform(0.0, 0.08))


def _leaf(dice: Dice, w: Number, h: Number, material: m.Material) -> Piece:
    """A door leaf about x = 0 with its front at y = 0."""
    piece = Piece().add(DOOR, material, box((-w / 2, -0.04, 0.005), (w / 2, 0, h)))
    kind = dice.count(0, 3)
    groove = m.plain(m.shade(material.color, 0.55))
    if kind == 1:
        spots = [
            (-0.36, -0.04, 0.07, 0.42),
            (0.04, 0.36, 0.07, 0.42),
            (-0.36, -0.04, 0.5, 0.92),
            (0.04, 0.36, 0.5, 0.92),
        ]
    elif kind == 2:
        spots = [(-0.34, 0.34, 0.08, 0.4), (-0.34, 0.34, 0.5, 0.92)]
    else:
        spots = []
    for a, b, low, high in spots:
        for y in (0.0, -0.04):
            outer = box((a * w, y - 0.004, low * h), (b * w, y + 0.004, high * h))
            inner = box(
                (a * w + 0.02, y - 0.008, low * h + 0.02),
                (b * w - 0.02, y + 0.008, high * h - 0.02),
            )
            piece.add(DOOR, groove, outer).add(DOOR, material, inner)
    if kind == 3 and dice.chance(0.4):
        glass = m.plain(m.srgb(170, 185, 190), 1.5)
        piece.add(DOOR, glass, box((-0.3 * w, -0.042, 0.45 * h), (0.3 * w, 0.002, 0.92 * h)))
    metal = m.metal(dice)
    x = w / 2 - 0.07
    if dice.chance(0.5):
        piece.add(DOOR, metal, cushion((x - 0.03, 0.0, 0.97), (x + 0.03, 0.07, 1.03), 1, 6))
    else:
        piece.add(DOOR, metal, box((x - 0.02, 0, 0.95), (x + 0.02, 0.006, 1.1)))
        piece.add(
            DOOR, metal, tube([(x, 0.0, 1.03), (x, 0.05, 1.03), (x - 0.12, 0.05, 1.03)], 0.01)
        )
    return piece


def _hallway(w: Number, h: Number, floor: m.Material, paint: m.Material) -> Piece:
    low, high, far = -w / 2 - 0.4, w / 2 + 0.4, -1.5
    piece = Piece().add(FLOOR, floor, box((low, far, -0.1), (high, 0, 0)))
    piece.add(WALL, paint, box((low, far - 0.05, 0), (high, far, h + 0.2)))
    piece.add(WALL, paint, box((low - 0.05, far, 0), (low, -0.1, h + 0.2)))
    piece.add(WALL, paint, box((high, far, 0), (high + 0.05, -0.1, h + 0.2)))
    return piece.add(CLUTTER, m.plain(m.WHITE), box((low, far, h + 0.2), (high, -0.1, h + 0.25)))


def window(dice: Dice, w: Number, h: Number, daylight: Number) -> Piece:
    """Fills a hole w x h whose lower left is at (-w/2, 0): reveal, frame, bars, bright panes."""
    deep = dice.uniform(0.06, 0.2)
    frame = m.plain(m.WHITE, 0.2) if dice.chance(0.75) else m.wood(dice)
    piece = Piece()
    reveal = frame if dice.chance(0.5) else m.plain(m.WHITE)
    for low, high in [
        ((-w / 2 - 0.02, -deep, 0), (-w / 2, 0, h)), ((w / 2, -deep, 0), (w / 2 + 0.02, 0, h)),
        ((-w / 2, -deep, h), (w / 2, 0, h + 0.02)),
        ((-w / 2 - 0.03, -deep, -0.03), (w / 2 + 0.03, dice.uniform(0.0, 0.05), 0)),
    ]:  # fmt: skip
        piece.add(WINDOW, reveal, box(low, high))
    piece.add(WINDOW, _view(dice, daylight), _pane(w + 0.1, h + 0.1, -deep))
    columns, rows = dice.pick([(1, 1), (2, 1), (2, 1), (2, 2), (3, 1), (3, 2)])
    bar = dice.uniform(0.03, 0.06)
    for x in np.linspace(-w / 2, w / 2, columns + 1):
        piece.add(WINDOW, frame, box((x - bar / 2, -deep, 0), (x + bar / 2, -deep + 0.04, h)))
    for z in np.linspace(0, h, rows + 1):
        piece.add(
            WINDOW, frame, box((-w / 2, -deep, z - bar / 2), (w / 2, -deep + 0.04, z + bar / 2))
        )
    if dice.chance(0.12):
        piece.place(_blind(dice, w, h, -deep + 0.05))
    power = daylight * w * h
    color = (0.9 * power, 0.98 * power, 1.1 * power)
    piece.lights.append(
        Light(np.array([0, 0.01, h / 2]), np.array([w / 2.2, 0, 0]), np.array([0, 0, h / 2.2]),
              np.array([0.0, 1, 0]), color)
    )  # fmt: skip
    return piece


def _pane(w: Number, h: Number, y: Number) -> Soup:
    return sheet(
        lambda s, t: np.stack([(0.5 - s) * w, y + 0 * s, (1 - t) * h - 0.05], axis=2), 2, 2
    )


def _view(dice: Dice, daylight: Number) -> m.Material:
    sky = dice.pick([m.srgb(215, 230, 250), m.srgb(235, 240, 245), m.srgb(170, 205, 245)])
    far = dice.pick(
        [m.srgb(70, 105, 55), m.srgb(95, 115, 70), m.srgb(150, 130, 115), m.srgb(120, 120, 125)]
    )
    glow = 0.25 + 2.6 * daylight * dice.uniform(0.7, 1.3)
    return m.Material(
        "outside", sky, far, 1.0, dice.uniform(0.2, 1.0), 0.0, glow, dice.uniform(0, 50)
    )


def _blind(dice: Dice, w: Number, h: Number, y: Number) -> Piece:
    """Slats over the upper part of the panes."""
    material, piece = m.plain(m.vary(dice, m.WHITE, 0.1)), Piece()
    for z in np.arange(h - 0.03, h * dice.uniform(0.1, 0.7), -0.045):
        slat = box((-w / 2, y - 0.018, -0.001), (w / 2, y + 0.018, 0.001))
        piece.add(CLUTTER, material, slat.moved(y=-y).turned(35, "x").moved(y=y, z=z))
    return piece


def curtains(dice: Dice, w: Number, sill: Number, top: Number) -> Piece:
    """Curtains on a rod before a window w wide, down to the floor or the sill; z from the floor."""
    color = dice.pick(m.FABRICS + m.BRIGHTS + [m.WHITE, m.WHITE])
    cloth = m.fabric(dice, color)
    low = dice.uniform(0.02, 0.1) if dice.chance(0.7) else max(0.05, sill - 0.15)
    wide, y = w * dice.uniform(0.22, 0.5), 0.09
    edge = w / 2 + 0.18
    piece = Piece().add(
        CURTAIN, m.metal(dice), tube([(-edge - 0.08, y, top), (edge + 0.08, y, top)], 0.013)
    )
    sides = [-1, 1] if dice.chance(0.8) else [dice.pick([-1, 1])]
    for side in sides:
        left = -edge if side < 0 else edge - wide
        piece.add(
            CURTAIN, cloth, folds(dice, left, left + wide, low, top - 0.015, 0.032).moved(y=y)
        )
    return piece


def picture(dice: Dice) -> Piece:
    """A framed painting or photograph, or a bare poster, about the origin."""
    w, h = dice.uniform(0.22, 1.0), dice.uniform(0.22, 0.8)
    first, second = (m.srgb(*(dice.uniform(10, 250) for _ in range(3))) for _ in range(2))
    art = m.Material(
        "painting",
        first,
        second,
        1.0,
        dice.uniform(0, 1),
        dice.pick([0.0, 0.4]),
        0.0,
        dice.uniform(0, 50),
    )
    if dice.chance(0.2):
        return Piece().add(PICTURE, art, _canvas(w, h, 0.004))
    rim = dice.uniform(0.012, 0.05)
    frame = dice.pick(
        [m.wood(dice), m.plain(m.BLACK), m.plain(m.WHITE), m.plain(m.srgb(170, 135, 60), 0.8)]
    )
    piece = Piece()
    for low, high in [
        ((-w / 2, 0, -h / 2), (w / 2, 0.025, -h / 2 + rim)),
        ((-w / 2, 0, h / 2 - rim), (w / 2, 0.025, h / 2)),
        ((-w / 2, 0, -h / 2), (-w / 2 + rim, 0.025, h / 2)),
        ((w / 2 - rim, 0, -h / 2), (w / 2, 0.025, h / 2)),
    ]:
        piece.add(PICTURE, frame, box(low, high))
    w, h = w - 2 * rim, h - 2 * rim
    if dice.chance(0.4):
        piece.add(PICTURE, m.plain(m.WHITE), _canvas(w, h, 0.01))
        w, h = w * 0.72, h * 0.72
    return piece.add(PICTURE, art, _canvas(w, h, 0.014))


def _canvas(w: Number, h: Number, y: Number) -> Soup:
    face = sheet(lambda s, t: np.stack([(0.5 - s) * w, y + 0 * s, (0.5 - t) * h], axis=2), 2, 2)
    return Soup(face.corners, face.normals, face.uv / np.array([w, h]))


def mirror(dice: Dice) -> Piece:
    w, h = dice.uniform(0.4, 0.8), dice.uniform(0.5, 1.1)
    rim = dice.pick([m.wood(dice), m.metal(dice), m.plain(m.BLACK)])
    piece = Piece().add(CLUTTER, rim, box((-w / 2, 0, -h / 2), (w / 2, 0.02, h / 2)))
    face = box((-w / 2 + 0.03, 0.02, -h / 2 + 0.03), (w / 2 - 0.03, 0.022, h / 2 - 0.03))
    return piece.add(CLUTTER, m.plain(m.srgb(50, 54, 56), 8.0), face)


def radiator(dice: Dice) -> Piece:
    w, h = dice.uniform(0.6, 1.2), dice.uniform(0.45, 0.6)
    white, piece = m.plain(m.WHITE, 0.2), Piece()
    for x in np.arange(-w / 2, w / 2, 0.06):
        piece.add(CLUTTER, white, box((x, 0.04, 0.12), (x + 0.048, 0.12, 0.12 + h)))
    return piece.add(CLUTTER, white, box((-w / 2, 0.06, 0.16), (w / 2, 0.1, h + 0.08)))


def clock(dice: Dice) -> Piece:
    r = dice.uniform(0.12, 0.18)
    disc = cylinder(r, 0, 0.03, 20).turned(-90, "x")
    face = cylinder(r * 0.9, 0, 0.032, 20).turned(-90, "x")
    hand = box((-0.006, 0.032, 0), (0.006, 0.035, r * 0.7)).turned(dice.uniform(0, 360), "y")
    short = box((-0.007, 0.032, 0), (0.007, 0.035, r * 0.45)).turned(dice.uniform(0, 360), "y")
    piece = Piece().add(CLUTTER, m.plain(m.BLACK), disc, hand, short)
    return piece.add(CLUTTER, m.plain(m.WHITE), face)


def whiteboard(dice: Dice) -> Piece:
    w, h = dice.uniform(0.9, 1.6), dice.uniform(0.6, 1.0)
    piece = Piece().add(
        CLUTTER, m.plain(m.METALS[0], 0.6), box((-w / 2, 0, -h / 2), (w / 2, 0.02, h / 2))
    )
    face = box((-w / 2 + 0.02, 0.02, -h / 2 + 0.02), (w / 2 - 0.02, 0.022, h / 2 - 0.02))
    return piece.add(CLUTTER, m.plain(m.WHITE, 0.6), face)


def switch(dice: Dice) -> Piece:
    return Piece().add(CLUTTER, m.plain(m.WHITE), box((-0.04, 0, -0.04), (0.04, 0.012, 0.04)))
