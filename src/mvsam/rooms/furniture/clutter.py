"""Small things that lie and stand about; none of them has a class of its own."""

from collections.abc import Callable, Sequence

import numpy as np

from .. import materials as m
from ..classes import CLUTTER
from ..dice import Dice, Number
from ..mesh import box, cushion, cylinder, lathe, prism, rounded_outline, sheet, tapered, tube
from ..room import Light, Piece


def bright(dice: Dice) -> m.Material:
    return m.plain(m.vary(dice, dice.pick(m.BRIGHTS), 0.3), dice.pick([0.0, 0.2, 0.5]))


def book(dice: Dice) -> Piece:
    """A pile of one to four lying books."""
    piece, height = Piece(), 0.0
    for _ in range(dice.count(1, 4)):
        width, depth, thick = (
            dice.uniform(0.14, 0.24),
            dice.uniform(0.2, 0.3),
            dice.uniform(0.012, 0.04),
        )
        block = box((-width / 2, 0, 0), (width / 2, depth, thick))
        piece.add(CLUTTER, bright(dice), block.turned(dice.uniform(-12, 12)).moved(z=height))
        height += thick
    return piece


def book_row(dice: Dice, width: Number, depth: Number, height: Number) -> Piece:
    """Standing books that fill a shelf from x = 0 to about `width`."""
    piece, x = Piece(), 0.0
    palette = [bright(dice) for _ in range(6)]
    while x < width - 0.02:
        thick, tall = dice.uniform(0.015, 0.05), height * dice.uniform(0.6, 0.95)
        thick = min(thick, width - x)
        deep = depth * dice.uniform(0.65, 0.95)
        piece.add(CLUTTER, dice.pick(palette), box((x, 0, 0), (x + thick * 0.96, deep, tall)))
        x += thick
    return piece


def cup(dice: Dice) -> Piece:
    radius, height = dice.uniform(0.03, 0.05), dice.uniform(0.07, 0.12)
    return Piece().add(
        CLUTTER, bright(dice), cylinder(radius * 0.85, 0, height, 10, dice.uniform(1, 1.3))
    )


def bottle(dice: Dice) -> Piece:
    r, h = dice.uniform(0.025, 0.045), dice.uniform(0.16, 0.32)
    profile = [(0.001, 0), (r, 0), (r, 0.6 * h), (0.4 * r, 0.8 * h), (0.4 * r, h), (0.001, h)]
    return Piece().add(CLUTTER, bright(dice), lathe(profile, 10))


def vase(dice: Dice) -> Piece:
    r, h = dice.uniform(0.05, 0.09), dice.uniform(0.15, 0.35)
    profile = [(0.001, 0), (0.6 * r, 0), (r, 0.4 * h), (0.5 * r, 0.8 * h), (0.7 * r, h)]
    return Piece().add(CLUTTER, bright(dice), lathe(profile, 12))


def bowl(dice: Dice) -> Piece:
    r, h = dice.uniform(0.08, 0.16), dice.uniform(0.04, 0.09)
    profile = [(0.001, 0), (0.5 * r, 0), (r, h), (0.9 * r, h), (0.4 * r, 0.2 * h), (0.001, 0.2 * h)]
    return Piece().add(CLUTTER, bright(dice), lathe(profile, 14))


def carton(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.1, 0.4), dice.uniform(0.1, 0.35), dice.uniform(0.08, 0.35)
    brown = m.Material("speckle", m.vary(dice, m.srgb(176, 136, 96)), m.srgb(150, 110, 76), 0.01)
    paper = dice.pick([brown, bright(dice)])
    piece = Piece().add(CLUTTER, paper, box((-w / 2, 0, 0), (w / 2, d, h)))
    tape = m.plain(m.shade(paper.color, 1.25))
    return piece.add(
        CLUTTER, tape, box((-w / 2, d / 2 - 0.02, h), (w / 2, d / 2 + 0.02, h + 0.002))
    )


def bin_(dice: Dice) -> Piece:
    r, h = dice.uniform(0.1, 0.18), dice.uniform(0.25, 0.5)
    profile = [(0.001, 0), (0.8 * r, 0), (r, h), (0.95 * r, h), (0.77 * r, 0.02), (0.001, 0.02)]
    material = dice.pick([bright(dice), m.metal(dice), m.plain(m.BLACK), m.plain(m.WHITE)])
    return Piece().add(CLUTTER, material, lathe(profile, dice.pick([4, 12, 14])).moved(y=r))


def basket(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.3, 0.5), dice.uniform(0.25, 0.4), dice.uniform(0.2, 0.5)
    cane = m.Material("weave", m.vary(dice, m.srgb(180, 150, 105)), m.srgb(110, 80, 50), 0.02)
    piece = Piece().add(CLUTTER, cane, tapered((-w / 2, 0, 0), (w / 2, d, h), 1.12))
    heap = cushion((-w * 0.45, 0.04, h - 0.1), (w * 0.45, d - 0.04, h + 0.1), 0.8, 6)
    return piece.add(CLUTTER, m.fabric(dice), heap)


def plant(dice: Dice, height: Number | None = None) -> Piece:
    """A pot with arching leaves."""
    height = height or dice.uniform(0.25, 0.5)
    pot_height, r = 0.35 * height, 0.16 * height + 0.04
    piece = Piece().add(
        CLUTTER, bright(dice), cylinder(r * 0.8, 0, pot_height, 12, 1.25).moved(y=r)
    )
    green = m.srgb(dice.uniform(40, 90), dice.uniform(90, 140), dice.uniform(30, 70))
    leaf = m.plain(m.vary(dice, green), 0.2)
    reach = dice.uniform(0.35, 0.6) * height
    for _ in range(dice.count(12, 22)):
        wide, tall = dice.uniform(0.03, 0.07) + 0.02 * height, dice.uniform(0.4, 1.0)
        out = reach * dice.uniform(0.4, 1.0)

        def shape(s, t, wide=wide, tall=tall, out=out):
            x = (s - 0.5) * wide * np.sin(np.pi * (0.08 + 0.9 * t))
            z = pot_height + (height - pot_height) * tall * np.sin(1.9 * t)
            return np.stack([x, out * t, z], axis=2)

        piece.add(CLUTTER, leaf, sheet(shape, 5, 3).turned(dice.uniform(0, 360)).moved(y=r))
    return piece


def monitor(dice: Dice) -> Piece:
    w = dice.uniform(0.42, 0.65)
    h, z = w * 0.6, dice.uniform(0.08, 0.14)
    black = m.plain(dice.pick([m.BLACK, m.METALS[2]]), 0.4)
    piece = Piece().add(CLUTTER, black, box((-0.12, 0, 0), (0.12, 0.18, 0.012)))
    piece.add(CLUTTER, black, box((-0.03, 0.05, 0), (0.03, 0.08, z + 0.1)))
    piece.add(CLUTTER, black, box((-w / 2, 0.08, z), (w / 2, 0.11, z + h)))
    return piece.add(CLUTTER, *_display(dice, w - 0.03, h - 0.03, 0.111, z + 0.015))


def _display(dice: Dice, w: Number, h: Number, y: Number, z: Number):
    """Material and face of a screen; dark and shiny when off."""
    face = sheet(lambda s, t: np.stack([(0.5 - s) * w, y + 0 * s, z + (1 - t) * h], axis=2), 2, 2)
    if dice.chance(0.55):
        return m.plain(m.srgb(16, 17, 20), 1.3), face
    first = m.srgb(*(dice.uniform(20, 250) for _ in range(3)))
    glow = m.Material(
        "screen", first, m.srgb(235, 238, 245), 1.0, 1.0, 0.5, 0.9, dice.uniform(0, 50)
    )
    return glow, type(face)(face.corners, face.normals, face.uv / np.array([w, h]))


def laptop(dice: Dice) -> Piece:
    case = m.plain(dice.pick([m.METALS[0], m.BLACK, m.METALS[2]]), 0.4)
    piece = Piece().add(CLUTTER, case, box((-0.17, 0.02, 0), (0.17, 0.25, 0.016)))
    keys = m.plain(m.srgb(25, 25, 28))
    piece.add(CLUTTER, keys, box((-0.15, 0.06, 0.016), (0.15, 0.17, 0.018)))
    lid = Piece().add(CLUTTER, case, box((-0.17, -0.008, 0), (0.17, 0, 0.22)))
    lid.add(CLUTTER, *_display(dice, 0.32, 0.2, 0.001, 0.01))
    tilt = -dice.uniform(5, 25)
    for soup, label, material in lid.parts:
        piece.add(label, material, soup.turned(tilt, "x").moved(y=0.02, z=0.016))
    return piece


def television(dice: Dice, on_stand: bool = True) -> Piece:
    w = dice.uniform(0.7, 1.3)
    h, z = w * 0.57, 0.07 if on_stand else 0.0
    black = m.plain(m.BLACK, 0.5)
    piece = Piece().add(CLUTTER, black, box((-w / 2, 0.06, z), (w / 2, 0.1, z + h)))
    if on_stand:
        piece.add(CLUTTER, black, box((-w / 5, 0, 0), (w / 5, 0.2, 0.015)))
        piece.add(CLUTTER, black, box((-0.05, 0.06, 0), (0.05, 0.09, z)))
    return piece.add(CLUTTER, *_display(dice, w - 0.03, h - 0.03, 0.101, z + 0.015))


def keyboard(dice: Dice) -> Piece:
    case = m.plain(dice.pick([m.BLACK, m.WHITE, m.METALS[1]]))
    keys = m.Material("tiles", case.color, m.shade(case.color, 0.4), 0.02)
    piece = Piece().add(CLUTTER, case, box((-0.22, 0, 0), (0.22, 0.14, 0.015)))
    piece.add(CLUTTER, keys, box((-0.21, 0.01, 0.015), (0.21, 0.13, 0.022)))
    return piece.add(CLUTTER, case, cushion((0.27, 0.03, 0), (0.33, 0.13, 0.035), 0.8, 6))


def table_lamp(dice: Dice) -> Piece:
    h, r = dice.uniform(0.35, 0.55), dice.uniform(0.1, 0.17)
    lit = dice.chance(0.5)
    foot = dice.pick([bright(dice), m.metal(dice)])
    piece = Piece().add(
        CLUTTER, foot, lathe([(0.001, 0), (0.5 * r, 0), (0.5 * r, 0.02), (0.012, 0.05), (0.012, h)])
    )
    shade = m.plain(m.srgb(245, 230, 200), emission=1.6 if lit else 0.0)
    piece.add(CLUTTER, shade, lathe([(r, 0.58 * h), (dice.uniform(0.5, 1.0) * r, h + 0.03)], 14))
    if lit:
        piece.lights.append(_bulb(h * 0.8, 0.35))
    for i, (soup, label, material) in enumerate(piece.parts):
        piece.parts[i] = (soup.moved(y=r), label, material)
    piece.lights = [light.placed(0, np.array([0, r, 0])) for light in piece.lights]
    return piece


def _bulb(height: Number, power: Number) -> Light:
    color = (power * 1.0, power * 0.82, power * 0.58)
    small = np.eye(3) * 0.04
    return Light(np.array([0.0, 0, height]), small[0], small[1], np.zeros(3), color)


def floor_lamp(dice: Dice) -> Piece:
    h, r = dice.uniform(1.4, 1.7), dice.uniform(0.14, 0.22)
    lit = dice.chance(0.5)
    piece = Piece().add(
        CLUTTER, m.metal(dice), cylinder(0.14, 0, 0.025, 14), cylinder(0.012, 0, h, 6)
    )
    shade = m.plain(m.srgb(245, 232, 205), emission=1.8 if lit else 0.0)
    piece.add(CLUTTER, shade, lathe([(r, h - 0.28), (r * dice.uniform(0.6, 1.0), h)], 16))
    if lit:
        piece.lights.append(_bulb(h - 0.12, 0.8))
    return piece


def pillow(dice: Dice) -> Piece:
    size = dice.uniform(0.34, 0.46)
    soup = cushion((-size / 2, -0.07, 0), (size / 2, 0.07, size), 0.6, 6)
    return Piece().add(CLUTTER, m.fabric(dice, dice.pick(m.FABRICS + m.BRIGHTS)), soup)


def rug(dice: Dice, width: Number, depth: Number) -> Piece:
    """A thin cloth, round or square, about the origin."""
    color, second = dice.pick(m.FABRICS), dice.pick(m.FABRICS + m.BRIGHTS)
    pattern = dice.pick(["rug", "rug", "carpet", "stripes", "damask"])
    scale = 0.01 if pattern == "carpet" else dice.uniform(0.1, 0.35)
    cloth = m.Material(pattern, color, second, scale, 0.8, seed=dice.uniform(0, 50))
    if dice.chance(0.2):
        return Piece().add(CLUTTER, cloth, cylinder(min(width, depth) / 2, 0, 0.012, 28))
    outline = rounded_outline(width, depth, 0.03, 2)
    return Piece().add(CLUTTER, cloth, prism(outline, 0, 0.012))


def shoes(dice: Dice) -> Piece:
    piece, material = Piece(), bright(dice)
    for x in (-0.07, 0.07):
        piece.add(CLUTTER, material, cushion((x - 0.045, 0, 0), (x + 0.045, 0.27, 0.09), 0.7, 6))
    return piece


def bag(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.28, 0.42), dice.uniform(0.14, 0.22), dice.uniform(0.3, 0.48)
    cloth = m.fabric(dice, dice.pick(m.FABRICS + m.BRIGHTS))
    piece = Piece().add(CLUTTER, cloth, cushion((-w / 2, 0, 0), (w / 2, d, h), 0.5, 7))
    pocket = cushion((-w / 3, d - 0.05, 0.04), (w / 3, d + 0.05, h / 2), 0.5, 6)
    strap = tube([(-0.06, d / 2, h - 0.02), (-0.05, d / 2, h + 0.06), (0.05, d / 2, h + 0.06),
                  (0.06, d / 2, h - 0.02)], 0.01)  # fmt: skip
    return piece.add(CLUTTER, cloth, pocket, strap)


Place = tuple[Number, Number]
Maker = Callable[[Dice], Piece]

TABLE_THINGS = (book, cup, bottle, vase, bowl, plant, carton, book, cup)
FLOOR_THINGS = (bin_, basket, carton, plant, shoes, bag, bag, carton)


def scatter(
    dice: Dice, low: Place, high: Place, z: Number, count: int, things: Sequence[Maker]
) -> Piece:
    """Small things strewn over a rectangle without touching each other."""
    piece, taken = Piece(), []
    for _ in range(count):
        thing = dice.pick(things)(dice)
        first, last = thing.bounds()
        for _ in range(6):
            x, y = dice.uniform(low[0], high[0]), dice.uniform(low[1], high[1])
            a, b = np.add(first[:2], (x, y)), np.add(last[:2], (x, y))
            inside = (a >= low).all() and (b <= high).all()
            if inside and all((a > d).any() or (b < c).any() for c, d in taken):
                taken.append((a, b))
                piece.place(thing, 0, x, y, z)
                break
    return piece
