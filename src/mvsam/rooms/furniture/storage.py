"""Cabinets, drawers, wardrobes, bookshelves, refrigerators and the other boxes of a household."""

import itertools

import numpy as np

from .. import materials as m
from ..classes import BOOKSHELF, CABINET, CLUTTER, OTHER_FURNITURE, REFRIGERATOR
from ..dice import Dice, Number
from ..mesh import box, cushion, cylinder, tube
from ..room import Piece
from . import clutter


def fronts(
    dice: Dice, piece: Piece, label: int, material: m.Material,
    left: Number, right: Number, y: Number, low: Number, high: Number, columns: int, rows: int,
) -> None:  # fmt: skip
    """Door or drawer fronts with gaps and handles on the plane y, facing +y."""
    handle = dice.pick([m.metal(dice), m.plain(m.BLACK), m.metal(dice)])
    style, framed = dice.count(0, 2), dice.chance(0.35)
    gap, thick = 0.004, 0.018
    xs, zs = np.linspace(left, right, columns + 1), np.linspace(low, high, rows + 1)
    for i in range(columns):
        for j in range(rows):
            a, b = (xs[i] + gap, zs[j] + gap), (xs[i + 1] - gap, zs[j + 1] - gap)
            piece.add(label, material, box((a[0], y, a[1]), (b[0], y + thick, b[1])))
            if framed:
                _raised_frame(piece, label, material, a, b, y + thick)
            wide = b[0] - a[0] > b[1] - a[1]
            side = b[0] - 0.05 if i % 2 == 0 else a[0] + 0.05
            middle = ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)
            _handle(piece, label, handle, style, wide, middle, side, y + thick, b[1] - a[1])


def open_carcass(
    piece: Piece, label: int, material: m.Material, low: tuple[Number, Number, Number],
    high: tuple[Number, Number, Number], fill: Number,
) -> None:  # fmt: skip
    """A body solid up to height `fill`, with thin walls above, so that a basin can hang in it."""
    (x0, y0, _), (x1, y1, z1), t = low, high, 0.016
    piece.add(label, material, box(low, (x1, y1, fill)))
    piece.add(label, material, box((x0, y0, fill), (x0 + t, y1, z1)))
    piece.add(label, material, box((x1 - t, y0, fill), (x1, y1, z1)))
    piece.add(label, material, box((x0 + t, y1 - t, fill), (x1 - t, y1, z1)))


def _raised_frame(piece: Piece, label: int, material, a, b, y: Number) -> None:
    e, t = 0.05, 0.008
    piece.add(label, material, box((a[0], y, a[1]), (b[0], y + t, a[1] + e)))
    piece.add(label, material, box((a[0], y, b[1] - e), (b[0], y + t, b[1])))
    piece.add(label, material, box((a[0], y, a[1] + e), (a[0] + e, y + t, b[1] - e)))
    piece.add(label, material, box((b[0] - e, y, a[1] + e), (b[0], y + t, b[1] - e)))


def _handle(piece, label, material, style, wide, middle, side, y, height) -> None:
    x, z = middle if wide else (side, middle[1])
    if style == 0:
        piece.add(
            label,
            material,
            cushion((x - 0.016, y, z - 0.016), (x + 0.016, y + 0.03, z + 0.016), 1, 4),
        )
    elif style == 1:
        half = (0.07, 0, 0.006) if wide else (0.006, 0, min(0.08, height / 3))
        piece.add(
            label,
            material,
            box((x - half[0], y + 0.015, z - half[2]), (x + half[0], y + 0.027, z + half[2])),
        )
        piece.add(
            label,
            material,
            box(
                (x - half[0] / 2, y, z - half[2] / 2), (x + half[0] / 2, y + 0.02, z + half[2] / 2)
            ),
        )


def cabinet(dice: Dice) -> Piece:
    return dice.pick([sideboard, sideboard, drawers, wardrobe, tall_cabinet])(dice)


def _carcass(dice: Dice, w, d, h, columns, rows, plinth: bool = True) -> Piece:
    shell = m.board(dice)
    door = shell if dice.chance(0.7) else m.board(dice)
    foot = dice.uniform(0.04, 0.1) if plinth else 0.0
    piece = Piece().add(CABINET, shell, box((-w / 2, 0, foot), (w / 2, d - 0.02, h)))
    if plinth and dice.chance(0.5):
        base = box((-w / 2 + 0.02, 0.02, 0), (w / 2 - 0.02, d - 0.06, foot))
        piece.add(CABINET, m.plain(m.shade(shell.color, 0.5)), base)
    elif plinth:
        for x in (-w / 2 + 0.04, w / 2 - 0.04):
            for y in (0.04, d - 0.07):
                piece.add(CABINET, shell, cylinder(0.02, 0, foot, 8).moved(x, y))
    fronts(dice, piece, CABINET, door, -w / 2, w / 2, d - 0.02, foot, h - 0.015, columns, rows)
    return piece


def sideboard(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.8, 1.7), dice.uniform(0.36, 0.5), dice.uniform(0.6, 0.95)
    piece = _carcass(dice, w, d, h, max(2, round(w / 0.45)), dice.pick([1, 1, 2]))
    return _dressed(dice, piece, w, d, h)


def drawers(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.45, 1.2), dice.uniform(0.4, 0.5), dice.uniform(0.55, 1.15)
    piece = _carcass(dice, w, d, h, 1 if w < 0.75 else 2, max(3, round(h / 0.25)))
    return _dressed(dice, piece, w, d, h)


def wardrobe(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.8, 1.8), dice.uniform(0.5, 0.62), dice.uniform(1.8, 2.2)
    return _carcass(dice, w, d, h, max(2, round(w / 0.5)), 1)


def tall_cabinet(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.4, 0.95), dice.uniform(0.35, 0.5), dice.uniform(1.2, 1.9)
    return _carcass(dice, w, d, h, 1 if w < 0.55 else 2, dice.count(2, 4))


def television_stand(dice: Dice) -> Piece:
    w, d, h = dice.uniform(1.0, 1.7), dice.uniform(0.36, 0.46), dice.uniform(0.38, 0.58)
    piece = _carcass(dice, w, d, h, dice.count(2, 4), 1)
    return piece.place(clutter.television(dice), dice.uniform(-4, 4), 0, 0.1, h)


def nightstand(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.38, 0.52), dice.uniform(0.35, 0.45), dice.uniform(0.45, 0.62)
    piece = _carcass(dice, w, d, h, 1, dice.count(1, 3))
    if dice.chance(0.6):
        return piece.place(clutter.table_lamp(dice), 0, 0, 0.03, h)
    return _dressed(dice, piece, w, d, h)


def wall_cabinet(dice: Dice, w: Number) -> Piece:
    """Hangs above a worktop; its lower edge is at z = 0."""
    return _carcass(
        dice, w, 0.34, dice.uniform(0.55, 0.8), max(1, round(w / 0.45)), 1, plinth=False
    )


def _dressed(dice: Dice, piece: Piece, w: Number, d: Number, h: Number) -> Piece:
    things = (*clutter.TABLE_THINGS, clutter.table_lamp)
    low, high = (-w / 2 + 0.03, 0.02), (w / 2 - 0.03, d - 0.03)
    return piece.place(clutter.scatter(dice, low, high, h, dice.count(0, 5), things))


def bookshelf(dice: Dice) -> Piece:
    """Open shelves with books and other things; the class takes in what stands on them."""
    w, d, h = dice.uniform(0.6, 1.6), dice.uniform(0.24, 0.36), dice.uniform(0.9, 2.1)
    material, t = m.board(dice), 0.022
    piece = Piece()
    for x in (-w / 2, w / 2 - t):
        piece.add(BOOKSHELF, material, box((x, 0, 0), (x + t, d, h)))
    if dice.chance(0.75):
        back = m.plain(m.shade(material.color, 0.8))
        piece.add(BOOKSHELF, back, box((-w / 2, 0, 0.03), (w / 2, 0.008, h)))
    columns, rows = max(1, round(w / 0.7)), max(3, round(h / 0.34))
    for z in np.linspace(0.06, h - t, rows + 1):
        piece.add(BOOKSHELF, material, box((-w / 2, 0, z), (w / 2, d, z + t)))
    xs, zs = np.linspace(-w / 2, w / 2 - t, columns + 1), np.linspace(0.06, h - t, rows + 1)
    for x in xs[1:-1]:
        piece.add(BOOKSHELF, material, box((x, 0, 0.06), (x + t, d, h)))
    for left, right in itertools.pairwise(xs):
        for low, high in itertools.pairwise(zs):
            content = _shelf_content(dice, right - left - t, d, high - low - t)
            for soup, _, cover in content.parts:
                piece.add(BOOKSHELF, cover, soup.moved(left + t, 0.01, low + t))
    return piece


def _shelf_content(dice: Dice, w: Number, d: Number, h: Number) -> Piece:
    kind = dice.uniform()
    if kind < 0.68:
        return clutter.book_row(dice, w * dice.uniform(0.45, 0.98), d, h)
    if kind < 0.88:
        piece = clutter.scatter(
            dice, (0.02, 0.01), (w - 0.02, d), 0, dice.count(1, 3), clutter.TABLE_THINGS
        )
        keep = Piece()
        for part in piece.parts:
            if part[0].corners[..., 2].max() < h:
                keep.parts.append(part)
        return keep
    return Piece()


def refrigerator(dice: Dice) -> Piece:
    """One or two doors with long handles; white, steel or black."""
    w, d, h = dice.uniform(0.6, 0.9), dice.uniform(0.62, 0.75), dice.uniform(1.5, 1.85)
    if dice.chance(0.15):
        w, d, h = dice.uniform(0.48, 0.56), dice.uniform(0.5, 0.56), dice.uniform(0.82, 0.9)
    color, gloss = dice.pick(
        [(m.WHITE, 0.5), (m.WHITE, 0.4), (m.METALS[0], 1.6), (m.METALS[0], 1.2), (m.BLACK, 0.9)]
    )
    skin = m.plain(m.vary(dice, color, 0.06), gloss)
    piece = Piece().add(REFRIGERATOR, skin, box((-w / 2, 0, 0.03), (w / 2, d - 0.06, h)))
    piece.add(
        REFRIGERATOR,
        m.plain(m.BLACK),
        box((-w / 2 + 0.02, 0.02, 0), (w / 2 - 0.02, d - 0.09, 0.05)),
    )
    split = dice.pick([0.32, 0.68, 0.62]) * h
    panels = [(-w / 2, w / 2, 0.06, split - 0.005), (-w / 2, w / 2, split + 0.005, h)]
    if w > 0.8:
        panels = [
            (-w / 2, -0.004, split, h),
            (0.004, w / 2, split, h),
            (-w / 2, w / 2, 0.06, split - 0.01),
        ]
    grip = dice.pick([m.metal(dice), m.plain(color, 0.5), m.plain(m.BLACK)])
    for i, (left, right, low, high) in enumerate(panels):
        piece.add(REFRIGERATOR, skin, box((left, d - 0.055, low), (right, d, high)))
        x = right - 0.05 if i == 0 else left + 0.05
        bar = [
            (x, d, low + 0.08),
            (x, d + 0.04, low + 0.1),
            (x, d + 0.04, high - 0.1),
            (x, d, high - 0.08),
        ]
        for k in range(3):
            piece.add(REFRIGERATOR, grip, tube(bar[k : k + 2], 0.011))
    for _ in range(dice.pick([0, 0, 2, 5])):
        x, z = dice.uniform(-w / 2 + 0.08, w / 2 - 0.15), dice.uniform(split + 0.05, h - 0.15)
        note = box((x, d, z), (x + dice.uniform(0.05, 0.1), d + 0.003, z + 0.1))
        piece.add(CLUTTER, clutter.bright(dice), note)
    return piece


def other_furniture(dice: Dice) -> Piece:
    return dice.pick([washer, piano, coat_rack, trolley, rack])(dice)


def washer(dice: Dice) -> Piece:
    w, d, h = 0.6, dice.uniform(0.55, 0.65), 0.85
    skin = m.plain(dice.pick([m.WHITE, m.WHITE, m.METALS[0]]), 0.4)
    piece = Piece().add(OTHER_FURNITURE, skin, box((-w / 2, 0, 0), (w / 2, d, h)))
    ring = cylinder(0.2, 0, 0.03, 20).turned(-90, "x").moved(y=d, z=0.45)
    glass = cylinder(0.15, 0, 0.036, 18).turned(-90, "x").moved(y=d, z=0.45)
    piece.add(OTHER_FURNITURE, m.metal(dice), ring).add(
        OTHER_FURNITURE, m.plain(m.BLACK, 1.5), glass
    )
    panel = box((-w / 2 + 0.02, d, h - 0.12), (w / 2 - 0.02, d + 0.008, h - 0.02))
    return piece.add(OTHER_FURNITURE, m.plain(m.METALS[1]), panel)


def piano(dice: Dice) -> Piece:
    w, d, h = 1.4, 0.6, dice.uniform(1.1, 1.25)
    case = m.plain(m.BLACK, 1.0) if dice.chance(0.5) else m.wood(dice)
    piece = Piece().add(OTHER_FURNITURE, case, box((-w / 2, 0, 0), (w / 2, 0.34, h)))
    piece.add(OTHER_FURNITURE, case, box((-w / 2, 0.34, 0.62), (w / 2, d, 0.7)))
    for x in (-w / 2, w / 2 - 0.06):
        piece.add(OTHER_FURNITURE, case, box((x, 0.34, 0), (x + 0.06, d, 0.76)))
    piece.add(
        OTHER_FURNITURE,
        m.plain(m.WHITE),
        box((-w / 2 + 0.08, 0.42, 0.7), (w / 2 - 0.08, d - 0.02, 0.72)),
    )
    for i in range(36):
        if i % 7 in (2, 6):
            continue
        x = -w / 2 + 0.1 + i * 0.0335
        piece.add(OTHER_FURNITURE, m.plain(m.BLACK), box((x, 0.42, 0.72), (x + 0.014, 0.51, 0.73)))
    return piece


def coat_rack(dice: Dice) -> Piece:
    h, frame = dice.uniform(1.6, 1.85), m.wood(dice) if dice.chance(0.5) else m.metal(dice)
    piece = Piece().add(
        OTHER_FURNITURE, frame, cylinder(0.022, 0, h, 8), cylinder(0.2, 0, 0.03, 14)
    )
    for turn in range(0, 360, 60):
        hook = tube([(0, 0, h - 0.1), (0.1, 0, h - 0.06), (0.14, 0, h)], 0.01).turned(turn)
        piece.add(OTHER_FURNITURE, frame, hook)
        if dice.chance(0.5):
            coat = cushion((0.03, -0.16, h - 0.9), (0.2, 0.16, h - 0.08), 0.7, 7).turned(turn)
            piece.add(CLUTTER, m.fabric(dice), coat)
    return Piece().place(piece, 0, y=0.25)


def trolley(dice: Dice) -> Piece:
    w, d, h = dice.uniform(0.45, 0.7), dice.uniform(0.35, 0.45), dice.uniform(0.75, 0.9)
    return _open_rack(dice, w, d, h, 3)


def rack(dice: Dice) -> Piece:
    """A metal store rack with cartons."""
    return _open_rack(
        dice, dice.uniform(0.8, 1.2), dice.uniform(0.35, 0.5), dice.uniform(1.3, 1.8), 4
    )


def _open_rack(dice: Dice, w: Number, d: Number, h: Number, levels: int) -> Piece:
    frame, piece = m.metal(dice), Piece()
    for x in (-w / 2, w / 2):
        for y in (0.015, d - 0.015):
            piece.add(OTHER_FURNITURE, frame, cylinder(0.013, 0, h, 6).moved(x, y))
    for z in np.linspace(0.12, h - 0.04, levels):
        piece.add(OTHER_FURNITURE, frame, box((-w / 2, 0, z), (w / 2, d, z + 0.02)))
        things = (clutter.carton, clutter.bottle, clutter.book, clutter.bowl)
        load = clutter.scatter(dice, (-w / 2, 0), (w / 2, d), z + 0.02, dice.count(1, 4), things)
        piece.place(load)
    return piece
