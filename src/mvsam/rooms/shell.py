"""The empty room: its plan, doors and windows, and at last its walls, floor and ceiling."""

import numpy as np

from . import materials as m
from .classes import CLUTTER, FLOOR, WALL
from .dice import Dice, Number
from .furniture import wall_items
from .mesh import box, prism
from .plan import Plan, Wall
from .room import Piece

Rectangle = tuple[Number, Number, Number, Number]
"""x and y of the low corner, of the high corner."""


def empty_plan(dice: Dice, kind: str) -> Plan:
    """A box, an L, a room with one alcove or with two."""
    small = kind in ("bathroom", "kitchen")
    width = dice.uniform(2.4, 3.8) if small else dice.uniform(2.9, 5.8)
    length = dice.uniform(2.5, 4.2) if small else dice.uniform(3.1, 7.0)
    height = dice.uniform(2.3, 3.0) if dice.chance(0.85) else dice.uniform(3.0, 3.4)
    rectangles: list[Rectangle] = [(0.0, 0.0, width, length)]
    shape = dice.uniform()
    if shape < 0.22 and not small:
        notch, deep = dice.uniform(0.3, 0.5) * width, dice.uniform(0.25, 0.5) * length
        rectangles = [(0.0, 0.0, width, length - deep), (0.0, length - deep, width - notch, length)]
    elif shape < 0.4:
        rectangles.append(_alcove(dice, width, length))
    elif shape < 0.48 and not small:
        first, (x0, y0, x1, y1) = _alcove(dice, width, length), _alcove(dice, width, length)
        rectangles += [first, (x0, -(y1 - y0), x1, 0.0)]
    return Plan(rectangles, height)


def _alcove(dice: Dice, width: Number, length: Number) -> Rectangle:
    left = dice.uniform(0.1, 0.4) * width
    return left, length, left + dice.uniform(0.4, 0.5) * width, length + dice.uniform(0.4, 1.6)


def add_corners(dice: Dice, plan: Plan, paint: m.Material) -> None:
    """A chimney breast or a column at a wall, a corner cut off, a beam; in some rooms."""
    tall = plan.height
    if dice.chance(0.2):
        w, deep = dice.uniform(0.3, 1.5), dice.uniform(0.15, 0.5)
        breast = Piece().add(WALL, paint, box((-w / 2, 0, 0), (w / 2, deep, tall)))
        plan.at_wall(dice, breast, gap=0.0, corner=dice.chance(0.3))
    if dice.chance(0.15):
        side = dice.uniform(0.4, 1.2)
        wall = dice.pick(plan.walls)
        wedge = Piece().add(WALL, paint, prism([(0, 0), (side, 0), (0, side)], 0, tall))
        plan.put(wedge, wall.angle_deg, *wall.point(0.0))
    if dice.chance(0.1):
        x0, y0, x1, y1 = plan.rectangles[0]
        y, thick = y0 + dice.uniform(0.2, 0.8) * (y1 - y0), dice.uniform(0.15, 0.3)
        beam = box((x0, y, tall - dice.uniform(0.1, 0.25)), (x1, y + thick, tall))
        plan.piece.add(CLUTTER, m.wood(dice) if dice.chance(0.4) else paint, beam)


def cut_doors(dice: Dice, plan: Plan, ground: m.Material, paint: m.Material) -> None:
    for _ in range(dice.pick([1, 1, 2])):
        w, h = dice.uniform(0.76, 0.95), min(dice.uniform(1.98, 2.1), plan.height - 0.12)
        spot = plan.cut(dice, w, 0.0, h, 0.95)
        if spot:
            wall, along, _ = spot
            plan.piece.place(
                wall_items.door(dice, w, h, ground, paint), wall.angle_deg, *wall.point(along)
            )


def cut_windows(dice: Dice, plan: Plan, kind: str, daylight: Number) -> float:
    """Windows, most with curtains; returns the total light they let in."""
    total = 0.0
    for _ in range(dice.pick([1, 1, 2, 2] if kind != "bathroom" else [0, 1, 1])):
        w = dice.uniform(0.5, 0.9) if kind == "bathroom" else dice.uniform(0.8, 2.0)
        sill = (
            dice.uniform(1.05, 1.35) if kind in ("bathroom", "kitchen") else dice.uniform(0.45, 1.0)
        )
        top = min(plan.height - 0.2, dice.uniform(1.95, 2.3))
        spot = plan.cut(dice, w, sill, top, 0.08)
        if not spot:
            continue
        wall, along, reserved = spot
        total += daylight * w * (top - sill)
        glazed = wall_items.window(dice, w, top - sill, daylight)
        plan.piece.place(glazed, wall.angle_deg, *wall.point(along), sill)
        if dice.chance(0.75 if kind != "bathroom" else 0.25):
            rod = min(top + 0.14, plan.height - 0.03)
            cloth = wall_items.curtains(dice, w, sill, rod)
            plan.put(cloth, wall.angle_deg, *wall.point(along, 0.01), over=reserved)
        elif dice.chance(0.4) and sill > 0.75:
            plan.put(
                wall_items.radiator(dice), wall.angle_deg, *wall.point(along, 0.01), over=reserved
            )
    return total


def enclose(dice: Dice, plan: Plan, ground: m.Material, paint: m.Material) -> None:
    """Floor, ceiling, walls, boards, and a black hull around all that no ray gets past."""
    above = m.ceiling(dice)
    for x0, y0, x1, y1 in plan.rectangles:
        plan.piece.add(FLOOR, ground, box((x0, y0, -0.05), (x1, y1, 0)))
        plan.piece.add(CLUTTER, above, box((x0, y0, plan.height), (x1, y1, plan.height + 0.05)))
    _paint_walls(dice, plan, paint)
    trim = m.plain(m.WHITE) if dice.chance(0.6) else m.wood(dice)
    if dice.chance(0.7):
        _boards(plan, 0.0, dice.uniform(0.05, 0.14), 0.012, trim)
    if dice.chance(0.25):  # a moulding below the ceiling
        low = plan.height - dice.uniform(0.04, 0.12)
        _boards(plan, low, plan.height, dice.uniform(0.02, 0.06), m.plain(m.WHITE))
    low = np.array(plan.rectangles)[:, :2].min(axis=0) - 2.5
    high = np.array(plan.rectangles)[:, 2:].max(axis=0) + 2.5
    hull = box((*low, -0.5), (*high, plan.height + 0.5))
    plan.piece.add(CLUTTER, m.plain((0.01, 0.01, 0.01)), hull)


def _paint_walls(dice: Dice, plan: Plan, paint: m.Material) -> None:
    """Walls of one paint, at times one of them of another, at times panelled half-way up."""
    accent = m.wall_paint(dice) if dice.chance(0.25) else paint
    chosen = dice.count(0, len(plan.walls) - 1)
    panelled = dice.uniform(0.8, 1.5) if dice.chance(0.15) else 0.0
    lower = m.panelling(dice)
    for number, wall in enumerate(plan.walls):
        if panelled:
            plan.piece.add(WALL, lower, wall.surface(0.0, panelled))
        color = accent if number == chosen else paint
        plan.piece.add(WALL, color, wall.surface(panelled, plan.height))
    if panelled and dice.chance(0.6):
        _boards(plan, panelled, panelled + dice.uniform(0.03, 0.08), 0.015, lower)


def _boards(plan: Plan, low: Number, high: Number, thick: Number, trim: m.Material) -> None:
    """Along all walls between two heights, left out where a hole is."""
    for wall in plan.walls:
        for start, end in _between_holes(wall, low, high):
            board = box((start, 0, low), (end, thick, high)).turned(wall.angle_deg)
            plan.piece.add(WALL, trim, board.moved(*wall.start))


def _between_holes(wall: Wall, low: Number, high: Number) -> list[tuple[Number, Number]]:
    """(from, to) along a wall where nothing is cut out between two heights; frames are 7 cm."""
    holes = sorted((a, b) for a, b, bottom, top in wall.holes if bottom < high and top > low)
    edges = [0.0, *(v for a, b in holes for v in (a - 0.07, b + 0.07)), wall.length]
    pairs = zip(edges[::2], edges[1::2], strict=True)
    return [(start, end) for start, end in pairs if end - start > 0.02]
