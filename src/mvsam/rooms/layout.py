"""Rooms furnished for living, sleeping, cooking, washing, working and eating."""

from collections.abc import Callable

import numpy as np

from . import materials as m
from .assets import Assets
from .dice import Dice, Number
from .furniture import bathroom, beds, clutter, kitchen, seating, storage, tables, wall_items
from .lamps import bounced_light, hang_lamps
from .plan import Plan
from .room import Piece, Room
from .shell import add_corners, cut_doors, cut_windows, empty_plan, enclose

KINDS = ("living", "bedroom", "kitchen", "bathroom", "office", "dining", "mixed", "bare")
_SHARES = (0.21, 0.13, 0.18, 0.20, 0.11, 0.05, 0.06, 0.06)
"""Small rare things live in kitchens and bathrooms, so these come more often than in homes."""


def build_room(dice: Dice, assets: Assets | None = None, kind: str | None = None) -> Room:
    """A furnished room, with some things and surfaces of the asset pack if one is given.

    kind: one of KINDS; none: drawn.
    """
    kind = kind or KINDS[dice.weighted(_SHARES)]
    plan = empty_plan(dice, kind)
    wet = kind in ("kitchen", "bathroom")
    paint, ground = m.wall_paint(dice), m.floor(dice, wet)
    if kind == "bathroom" and dice.chance(0.6):
        paint = m.wall_tiles(dice)
    if assets:
        paint, ground = assets.surfaces(dice, paint, ground)
    cut_doors(dice, plan, ground, paint)
    daylight = dice.uniform(0.35, 1.6) if dice.chance(0.8) else dice.uniform(0.02, 0.1)
    bright = cut_windows(dice, plan, kind, daylight)
    add_corners(dice, plan, paint)
    if assets:
        _place_models(dice, plan, assets, kind, dice.count(0, 3))
    _FURNISH[kind](dice, plan)
    if assets:
        _place_models(dice, plan, assets, kind, dice.count(2, 6))
    _wall_decoration(dice, plan, kind)
    _floor_clutter(dice, plan)
    hang_lamps(dice, plan, kind, bright)
    enclose(dice, plan, ground, paint)
    ambient = bounced_light(dice, plan, paint)
    return Room(plan.piece, kind, ambient, np.array(plan.rectangles))


def _place_models(dice: Dice, plan: Plan, assets: Assets, kind: str, count: int) -> None:
    """Some models of the pack: on walls, against walls, at times in the middle of the floor."""
    for _ in range(count):
        mount = dice.pick(["floor", "floor", "floor", "wall"])
        found = assets.thing(dice, mount, kind)
        if found is None:
            continue
        thing, height = found
        if mount == "floor" and dice.chance(0.25):
            plan.in_middle(dice, thing, tries=8)
        else:
            gap = dice.uniform(0.01, 0.1) if mount == "floor" else 0.0
            plan.at_wall(dice, thing, z=height, gap=gap, tries=10)


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
        storage.cabinet, storage.drawers, storage.other_furniture, seating.armchair, seating.chair,
        seating.ottoman, tables.side_table, tables.dining_set, storage.trolley,
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
