"""Ceiling lamps, and the light that has bounced about."""

import numpy as np

from . import materials as m
from .classes import CLUTTER
from .dice import Dice, Number
from .furniture import clutter
from .mesh import box, lathe, prism, rounded_outline
from .plan import Plan
from .room import Light, Piece


def hang_lamps(dice: Dice, plan: Plan, kind: str, daylight: Number) -> None:
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


def bounced_light(dice: Dice, plan: Plan, paint: m.Material) -> m.Color:
    """Light that has bounced about: a share of all lamps and windows, tinted by the walls."""
    x0, y0, x1, y1 = plan.rectangles[0]
    area = (x1 - x0) * (y1 - y0)
    total = sum((np.array(light.power) for light in plan.piece.lights), start=np.full(3, 0.3))
    tint = 0.55 + 0.45 * np.array(paint.color) / max(paint.color)
    red, green, blue = (float(v) for v in total * tint * dice.uniform(1.1, 2.0) / (area + 6))
    return red, green, blue
