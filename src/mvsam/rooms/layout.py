"""Rooms furnished for living, sleeping, cooking, washing, working and eating."""

from collections.abc import Callable

import numpy as np

from . import materials as m
from .classes import CLUTTER, FLOOR, WALL
from .dice import Dice, Number
from .furniture import bathroom, beds, clutter, kitchen, seating, storage, tables, wall_items
from .mesh import box, lathe, prism, rounded_outline
from .plan import Plan
from .room import Light, Piece, Room

KINDS = ("living", "bedroom", "kitchen", "bathroom", "office", "dining", "mixed", "bare")
_SHARES = (0.21, 0.13, 0.18, 0.20, 0.11, 0.05, 0.06, 0.06)
"""Small rare things live in kitchens and bathrooms, so these come more often than in homes."""


def build_room(dice: Dice) -> Room:
    kind = KINDS[dice.weighted(_SHARES)]
    plan = _shell(dice, kind)
    wet = kind in ("kitchen", "bathroom")
    paint, ground = m.wall_paint(dice), m.floor(dice, wet)
    if kind == "bathroom" and dice.chance(0.6):
        paint = m.wall_tiles(dice)
    _doors(dice, plan, ground, paint)
    daylight = dice.uniform(0.35, 1.6) if dice.chance(0.8) else dice.uniform(0.02, 0.1)
    bright = _windows(dice, plan, kind, daylight)
    _FURNISH[kind](dice, plan)
    _wall_decoration(dice, plan, kind)
    _floor_clutter(dice, plan)
    _lamps(dice, plan, kind, bright)
    _enclose(dice, plan, ground, paint)
    ambient = _ambient(dice, plan, paint, bright)
    return Room(plan.piece, kind, ambient, np.array(plan.rectangles))


def _shell(dice: Dice, kind: str) -> Plan:
    small = kind in ("bathroom", "kitchen")
    width = dice.uniform(2.5, 3.8) if small else dice.uniform(3.0, 5.6)
    length = dice.uniform(2.6, 4.2) if small else dice.uniform(3.2, 6.5)
    height = dice.uniform(2.3, 3.0) if dice.chance(0.85) else dice.uniform(3.0, 3.2)
    rectangles = [(0.0, 0.0, width, length)]
    shape = dice.uniform()
    if shape < 0.2 and not small:
        notch, deep = dice.uniform(0.3, 0.45) * width, dice.uniform(0.3, 0.45) * length
        rectangles = [(0.0, 0.0, width, length - deep), (0.0, length - deep, width - notch, length)]
    elif shape < 0.35:
        left = dice.uniform(0.1, 0.4) * width
        rectangles.append(
            (left, length, left + dice.uniform(0.4, 0.5) * width, length + dice.uniform(0.4, 1.0))
        )
    return Plan(rectangles, height)


def _doors(dice: Dice, plan: Plan, ground: m.Material, paint: m.Material) -> None:
    for _ in range(dice.pick([1, 1, 2])):
        w, h = dice.uniform(0.76, 0.95), min(dice.uniform(1.98, 2.1), plan.height - 0.12)
        spot = plan.cut(dice, w, 0.0, h, 0.95)
        if spot:
            wall, along, _ = spot
            plan.piece.place(
                wall_items.door(dice, w, h, ground, paint), wall.angle_deg, *wall.point(along)
            )


def _windows(dice: Dice, plan: Plan, kind: str, daylight: Number) -> float:
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


def _try(
    dice: Dice, plan: Plan, maker: Callable[[Dice], Piece], chance: Number,
    gap: Number = 0.01, front: Number = 0.0, corner: bool = False,
) -> None:  # fmt: skip
    """With this chance, make a thing and put it against a wall; another if it does not fit."""
    if dice.chance(chance):
        any(plan.at_wall(dice, maker(dice), gap=gap, front=front, corner=corner) for _ in range(2))


def _living(dice: Dice, plan: Plan) -> None:
    spot = next(
        (s for _ in range(4) if (s := plan.at_wall(dice, seating.sofa(dice), gap=0.04))), None
    )
    if spot:
        wall, along = spot
        low = tables.coffee_table(dice)
        place = wall.point(along, dice.uniform(1.35, 1.5))
        if dice.chance(0.75):
            plan.put(low, wall.angle_deg + dice.uniform(-4, 4), *place)
        if dice.chance(0.5):
            cloth = clutter.rug(dice, dice.uniform(1.6, 2.4), dice.uniform(1.2, 1.7))
            _lay(plan, cloth, wall.angle_deg, wall.point(along, 1.55))
    _try(dice, plan, storage.television_stand, 0.6, front=0.4)
    _try(dice, plan, storage.bookshelf, 0.75, front=0.4)
    _try(dice, plan, seating.armchair, 0.6, gap=0.15)
    _try(dice, plan, seating.sofa, 0.3)
    _try(dice, plan, storage.cabinet, 0.5, front=0.3)
    _try(dice, plan, seating.ottoman, 0.5, gap=0.05)
    _try(dice, plan, storage.piano, 0.12, front=0.4)
    _try(dice, plan, clutter.floor_lamp, 0.5, corner=True, gap=0.1)
    _try(dice, plan, tables.side_table, 0.4)
    if dice.chance(0.3):
        plan.in_middle(dice, tables.dining_set(dice))


def _lay(plan: Plan, cloth: Piece, angle_deg: Number, place: tuple[Number, Number]) -> None:
    """Rugs lie under other things, so only the walls stop them."""
    placed = Piece().place(cloth, angle_deg, *place)
    if plan.inside(*placed.bounds()):
        plan.piece.place(placed)


def _bedroom(dice: Dice, plan: Plan) -> None:
    for _ in range(4):
        spot = plan.at_wall(dice, beds.bed_set(dice) if dice.chance(0.7) else beds.bed(dice))
        if spot:
            wall, along = spot
            if dice.chance(0.35):
                _lay(plan, clutter.rug(dice, 2.2, 1.5), wall.angle_deg, wall.point(along, 1.7))
            break
    _try(dice, plan, storage.wardrobe, 0.7, front=0.5)
    _try(dice, plan, storage.drawers, 0.6, front=0.3)
    _try(dice, plan, tables.desk_set, 0.5)
    _try(dice, plan, storage.bookshelf, 0.4, front=0.3)
    _try(dice, plan, seating.sofa, 0.2)
    _try(dice, plan, seating.bench, 0.2)
    _try(dice, plan, seating.ottoman, 0.25)
    _try(dice, plan, seating.chair, 0.3)
    _try(dice, plan, clutter.floor_lamp, 0.3, corner=True, gap=0.1)
    _try(dice, plan, storage.coat_rack, 0.15, corner=True)


def _kitchen(dice: Dice, plan: Plan) -> None:
    upper = dice.chance(0.8)
    first = _run(dice, plan, upper)
    cold = storage.refrigerator(dice)
    if not (first and _beside(dice, plan, first, cold)):
        plan.at_wall(dice, cold, front=0.5, tries=30)
    if dice.chance(0.35):
        _run(dice, plan, upper)
    if dice.chance(0.75):
        plan.in_middle(dice, tables.dining_set(dice))
    _try(dice, plan, storage.tall_cabinet, 0.4, front=0.4)
    _try(dice, plan, storage.washer, 0.35, front=0.4)
    _try(dice, plan, storage.trolley, 0.3)
    _try(dice, plan, seating.chair, 0.5)


def _run(dice: Dice, plan: Plan, upper: bool):
    """The longest kitchen run that fits, with free floor before it."""
    for width in (dice.uniform(2.2, 3.2), dice.uniform(1.8, 2.4), dice.uniform(1.3, 1.8), 1.1):
        spot = plan.at_wall(
            dice,
            kitchen.kitchen_run(dice, width, upper),
            gap=0.002,
            front=0.95,
            corner=dice.chance(0.7),
        )
        if spot:
            return (*spot, width)
        lower = plan.at_wall(dice, kitchen.kitchen_run(dice, width, False), gap=0.002, front=0.95)
        if lower:
            return (*lower, width)
    return None


def _beside(dice: Dice, plan: Plan, run, thing: Piece) -> bool:
    """Put a thing at the left or right end of a kitchen run."""
    wall, along, width = run
    half = float(thing.bounds()[1, 0])
    for side in dice.shuffled([-1, 1]):
        place = along + side * (width / 2 + half + 0.02)
        if plan.put(thing, wall.angle_deg, *wall.point(place, 0.02)):
            return True
    return False


def _bathroom(dice: Dice, plan: Plan) -> None:
    for _ in range(3):
        if plan.at_wall(dice, bathroom.tub_set(dice), gap=0.003, corner=True, front=0.55):
            break
    basin = bathroom.washbasin(dice)
    spot = plan.at_wall(dice, basin, gap=0.003, front=0.55, tries=40)
    if spot:
        wall, along = spot
        if dice.chance(0.85):
            plan.put(bathroom.washstand_mirror(dice), wall.angle_deg, *wall.point(along, 0.01), 1.2)
    for _ in range(2):
        if plan.at_wall(dice, bathroom.toilet(dice), gap=0.003, front=0.5, tries=60):
            break
    _try(dice, plan, storage.washer, 0.25, front=0.4)
    _try(dice, plan, storage.tall_cabinet, 0.3, front=0.3)
    _try(dice, plan, bathroom.towel_rail, 0.7)
    _try(dice, plan, bathroom.paper_holder, 0.6)
    if dice.chance(0.5):
        x0, y0, x1, y1 = plan.rectangles[0]
        place = dice.uniform(x0 + 0.6, x1 - 0.6), dice.uniform(y0 + 0.6, y1 - 0.6)
        _lay(plan, clutter.rug(dice, dice.uniform(0.6, 0.9), 0.5), dice.pick([0, 90]), place)


def _office(dice: Dice, plan: Plan) -> None:
    for chance in (1.0, 0.75, 0.4):
        _try(dice, plan, tables.desk_set, chance)
    _try(dice, plan, storage.bookshelf, 0.8, front=0.3)
    _try(dice, plan, storage.cabinet, 0.7, front=0.3)
    _try(dice, plan, storage.bookshelf, 0.4, front=0.3)
    _try(dice, plan, storage.rack, 0.35)
    _try(dice, plan, storage.coat_rack, 0.3, corner=True)
    if dice.chance(0.45):
        plan.in_middle(dice, tables.office_table(dice))
    _try(dice, plan, seating.sofa, 0.4)
    _try(dice, plan, storage.refrigerator, 0.15, front=0.3)
    board = wall_items.whiteboard(dice)
    if dice.chance(0.5):
        plan.at_wall(dice, board, z=dice.uniform(1.4, 1.55))


def _dining(dice: Dice, plan: Plan) -> None:
    plan.in_middle(dice, tables.dining_set(dice), tries=40)
    _try(dice, plan, storage.sideboard, 0.8, front=0.2)
    _try(dice, plan, storage.tall_cabinet, 0.5, front=0.2)
    _try(dice, plan, storage.bookshelf, 0.4)
    _try(dice, plan, seating.bench, 0.3)
    _try(dice, plan, storage.refrigerator, 0.3, front=0.3)
    _try(dice, plan, storage.piano, 0.2, front=0.3)


def _mixed(dice: Dice, plan: Plan) -> None:
    """A studio: something of everything."""
    _try(dice, plan, beds.bed, 0.8)
    if dice.chance(0.5):
        _run(dice, plan, True)
    _try(dice, plan, storage.refrigerator, 0.7, front=0.3)
    _try(dice, plan, tables.desk_set, 0.7)
    _try(dice, plan, seating.sofa, 0.6)
    _try(dice, plan, storage.bookshelf, 0.6, front=0.2)
    _try(dice, plan, storage.cabinet, 0.6, front=0.2)
    _try(dice, plan, storage.other_furniture, 0.7)
    if dice.chance(0.6):
        plan.in_middle(dice, tables.dining_set(dice))


def _bare(dice: Dice, plan: Plan) -> None:
    """An empty room with a few things standing about in it."""
    makers = (
        storage.cabinet, storage.drawers, storage.other_furniture, seating.armchair,
        seating.chair, seating.ottoman, tables.side_table, tables.dining_set, storage.trolley,
        storage.refrigerator,
    )  # fmt: skip
    for _ in range(dice.count(1, 3)):
        plan.in_middle(dice, dice.pick(makers)(dice))


_FURNISH = {
    "living": _living, "bedroom": _bedroom, "kitchen": _kitchen, "bathroom": _bathroom,
    "office": _office, "dining": _dining, "mixed": _mixed,
    "bare": _bare,
}  # fmt: skip


def _wall_decoration(dice: Dice, plan: Plan, kind: str) -> None:
    _try(dice, plan, storage.other_furniture, 0.25)
    few = kind in ("bathroom", "kitchen")
    for _ in range(dice.count(0, 2) if few else dice.count(2, 6)):
        frame = wall_items.picture(dice)
        plan.at_wall(dice, frame, z=dice.uniform(1.35, 1.7), gap=0.0, tries=8)
    if dice.chance(0.2):
        plan.at_wall(dice, wall_items.mirror(dice), z=dice.uniform(1.3, 1.5), gap=0.0)
    if dice.chance(0.3):
        plan.at_wall(dice, wall_items.clock(dice), z=dice.uniform(1.8, 2.0), gap=0.0)
    for _ in range(2):
        plan.at_wall(dice, wall_items.switch(dice), z=dice.pick([0.3, 1.15]), gap=0.0)


def _floor_clutter(dice: Dice, plan: Plan) -> None:
    for _ in range(dice.count(1, 6)):
        plan.at_wall(
            dice, dice.pick(clutter.FLOOR_THINGS)(dice), gap=dice.uniform(0.02, 0.15), tries=6
        )
    if dice.chance(0.3):
        plan.at_wall(dice, clutter.plant(dice, dice.uniform(0.8, 1.5)), corner=True, gap=0.15)
    if dice.chance(0.35):
        plan.in_middle(dice, dice.pick(clutter.FLOOR_THINGS)(dice), tries=8)


def _lamps(dice: Dice, plan: Plan, kind: str, daylight: Number) -> None:
    """Ceiling lamps; they are off in some bright rooms."""
    lit = daylight < 0.8 or dice.chance(0.6)
    warm = dice.pick([(1.0, 0.93, 0.82), (1.0, 0.86, 0.68), (0.97, 0.99, 1.0), (1.0, 0.97, 0.92)])
    for x0, y0, x1, y1 in plan.rectangles[: dice.count(1, 2)]:
        spots = [(0.5, 0.5)] if (y1 - y0) < 4.5 else [(0.5, 0.27), (0.5, 0.73)]
        power = dice.uniform(1.6, 3.2) / len(spots) ** 0.5
        for u, v in spots:
            lamp = _ceiling_lamp(dice, kind, plan.height, power if lit else 0.0, warm)
            place = x0 + (x1 - x0) * u + dice.uniform(-0.3, 0.3), y0 + (y1 - y0) * v
            plan.piece.place(lamp, 0, *place)


def _ceiling_lamp(dice: Dice, kind: str, height: Number, power: Number, warm) -> Piece:
    glow = m.plain(warm, emission=3.0 if power else 0.0)
    office = kind in ("office", "kitchen") and dice.chance(0.5)
    piece, drop = Piece(), 0.07
    if office:
        w, d = dice.pick([(1.2, 0.3), (0.6, 0.6), (1.2, 0.15)])
        piece.add(
            CLUTTER, m.plain(m.WHITE), box((-w / 2, -d / 2, height - 0.06), (w / 2, d / 2, height))
        )
        piece.add(
            CLUTTER,
            glow,
            box((-w / 2.1, -d / 2.2, height - 0.065), (w / 2.1, d / 2.2, height - 0.06)),
        )
    elif dice.chance(0.6) or kind == "bathroom":
        w = d = dice.uniform(0.28, 0.45)
        dome = [
            (0.001, height - 0.1),
            (w / 3, height - 0.085),
            (w / 2, height - 0.03),
            (w / 2, height),
        ]
        piece.add(CLUTTER, glow, lathe(dome, 18))
        drop = 0.11
    else:
        w = d = dice.uniform(0.3, 0.5)
        drop = dice.uniform(0.35, 0.6)
        cord = box((-0.006, -0.006, height - drop), (0.006, 0.006, height))
        piece.add(CLUTTER, m.plain(m.BLACK), cord)
        bell = [
            (w / 2, height - drop - 0.02),
            (w / 2.4, height - drop + 0.08),
            (0.03, height - drop + 0.18),
        ]
        piece.add(CLUTTER, dice.pick([m.plain(m.WHITE), clutter.bright(dice)]), lathe(bell, 18))
        disc = prism(
            rounded_outline(w * 0.8, w * 0.8, w * 0.39), height - drop, height - drop + 0.005
        )
        piece.add(CLUTTER, glow, disc)
        drop += 0.03
    if power:
        red, green, blue = (power * c for c in warm)
        half = np.diag([w / 2, d / 2, 0.0])
        centre = np.array([0, 0, height - drop])
        piece.lights.append(Light(centre, half[0], half[1], np.zeros(3), (red, green, blue)))
    return piece


def _enclose(dice: Dice, plan: Plan, ground: m.Material, paint: m.Material) -> None:
    """Floor, ceiling, walls, skirting, and a black hull around all that no ray gets past."""
    ceiling = m.plain(m.vary(dice, m.srgb(238, 237, 233), 0.04), seed=dice.uniform(0, 50))
    accent = m.wall_paint(dice) if dice.chance(0.2) else paint
    for x0, y0, x1, y1 in plan.rectangles:
        plan.piece.add(FLOOR, ground, box((x0, y0, -0.05), (x1, y1, 0)))
        plan.piece.add(CLUTTER, ceiling, box((x0, y0, plan.height), (x1, y1, plan.height + 0.05)))
    tall = dice.uniform(0.05, 0.12) if dice.chance(0.7) else 0.0
    trim = m.plain(m.WHITE) if dice.chance(0.6) else m.wood(dice)
    chosen = dice.count(0, len(plan.walls) - 1)
    for number, wall in enumerate(plan.walls):
        plan.piece.add(WALL, accent if number == chosen else paint, wall.surface(plan.height))
        if tall:
            _skirting(plan, wall, tall, trim)
    low = np.array(plan.rectangles)[:, :2].min(axis=0) - 2.5
    high = np.array(plan.rectangles)[:, 2:].max(axis=0) + 2.5
    hull = box((*low, -0.5), (*high, plan.height + 0.5))
    plan.piece.add(CLUTTER, m.plain((0.01, 0.01, 0.01)), hull)


def _skirting(plan: Plan, wall, tall: Number, trim: m.Material) -> None:
    edges = [
        0.0,
        *(v for a, b, low, _ in sorted(wall.holes) if low == 0 for v in (a - 0.07, b + 0.07)),
        wall.length,
    ]
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        if end - start > 0.02:
            board = box((start, 0, 0), (end, 0.012, tall)).turned(wall.angle_deg)
            plan.piece.add(WALL, trim, board.moved(*wall.start))


def _ambient(dice: Dice, plan: Plan, paint: m.Material, daylight: Number) -> m.Color:
    """Light that has bounced about: a share of all lamps and windows, tinted by the walls."""
    x0, y0, x1, y1 = plan.rectangles[0]
    area = (x1 - x0) * (y1 - y0)
    total = sum((np.array(light.power) for light in plan.piece.lights), start=np.full(3, 0.3))
    tint = 0.55 + 0.45 * np.array(paint.color) / max(paint.color)
    red, green, blue = (float(v) for v in total * tint * dice.uniform(1.1, 2.0) / (area + 6))
    return red, green, blue
