"""What surfaces are made of: a pattern, two colours, gloss, light of their own."""

from dataclasses import dataclass, replace

import numpy as np

from .dice import Dice, Number

Color = tuple[float, float, float]
"""Linear-light albedo, 0..1."""

PATTERNS = (
    "plain", "wood", "planks", "tiles", "carpet", "brick", "stripes", "marble", "weave",
    "speckle", "painting", "outside", "plaid", "screen", "damask", "rug", "panels", "trellis",
    "image",
)  # fmt: skip


@dataclass(frozen=True)
class Material:
    """One surface; pictures of it are functions of the texture coordinates and the seed."""

    pattern: str
    color: Color
    second: Color
    scale: float = 1.0
    """Size of the pattern's unit, metres."""
    contrast: float = 1.0
    gloss: float = 0.0
    """0 is matt; 1 reflects like varnish at the Fresnel rate; above 1 more, like metal."""
    emission: float = 0.0
    seed: float = 0.0
    image: str = ""
    """Of the pattern `image`: the picture's file; `scale` metres of texture coordinates show it
    once, and `color` multiplies it."""

    def colored(self, color: Color) -> "Material":
        return replace(self, color=color)


def srgb(*values: Number) -> Color:
    """Linear albedo of an 8-bit display colour."""
    red, green, blue = (float((v / 255.0) ** 2.2) for v in values)
    return red, green, blue


def shade(color: Color, factor: Number) -> Color:
    red, green, blue = (float(np.clip(c * factor, 0.01, 0.92)) for c in color)
    return red, green, blue


def vary(dice: Dice, color: Color, amount: Number = 0.15) -> Color:
    """The colour, a little lighter or darker and slightly off in hue."""
    base = dice.uniform(1 - amount, 1 + amount)
    red, green, blue = (
        float(np.clip(c * base * dice.uniform(1 - amount / 3, 1 + amount / 3), 0.01, 0.9))
        for c in color
    )
    return red, green, blue


WOODS = [srgb(*c) for c in [
    (205, 170, 125), (181, 136, 92), (150, 104, 66), (120, 78, 48), (92, 58, 38), (70, 46, 34),
    (222, 196, 158), (160, 110, 70), (140, 84, 50), (190, 150, 105), (58, 42, 34), (168, 130, 96),
]]  # fmt: skip
WALLS = [srgb(*c) for c in [
    (235, 232, 224), (228, 222, 208), (240, 238, 234), (222, 214, 196), (214, 216, 214),
    (226, 226, 220), (205, 212, 216), (218, 206, 182), (232, 224, 200), (200, 206, 190),
    (190, 200, 210), (216, 196, 176), (178, 186, 190), (226, 210, 200),
]]  # fmt: skip
STRONG_WALLS = [srgb(*c) for c in [
    (150, 170, 190), (130, 150, 120), (190, 140, 110), (160, 90, 80), (110, 130, 150),
    (205, 175, 110), (95, 105, 115), (140, 120, 150),
]]  # fmt: skip
FABRICS = [srgb(*c) for c in [
    (130, 130, 132), (90, 92, 98), (60, 62, 70), (170, 160, 145), (196, 186, 168), (110, 90, 76),
    (80, 60, 52), (64, 82, 112), (92, 116, 150), (120, 50, 48), (146, 84, 60), (82, 104, 80),
    (40, 42, 48), (160, 140, 110), (208, 202, 192), (52, 92, 100), (178, 150, 70),
]]  # fmt: skip
BRIGHTS = [srgb(*c) for c in [
    (190, 50, 45), (40, 90, 170), (230, 180, 50), (60, 140, 80), (220, 110, 40), (120, 60, 140),
    (30, 140, 150), (220, 120, 150), (240, 236, 226), (40, 40, 46), (150, 200, 210), (90, 60, 40),
]]  # fmt: skip
METALS = [srgb(*c) for c in [(170, 172, 176), (120, 122, 126), (60, 60, 64), (190, 186, 178)]]
WHITE = srgb(240, 240, 238)
BLACK = srgb(30, 30, 33)


def plain(
    color: Color, gloss: Number = 0.0, emission: Number = 0.0, seed: Number = 0.0
) -> Material:
    return Material("plain", color, color, 1.0, 1.0, gloss, emission, seed)


def wood(dice: Dice, color: Color | None = None) -> Material:
    color = vary(dice, color or dice.pick(WOODS), 0.2)
    gloss = dice.pick([0.0, 0.2, 0.4, 0.8])
    return Material(
        "wood", color, shade(color, dice.uniform(0.55, 0.8)), dice.uniform(0.05, 0.14),
        dice.uniform(0.4, 1.0), gloss, 0.0, dice.uniform(0, 50),
    )  # fmt: skip


def painted(dice: Dice) -> Material:
    """Lacquered board: white, grey, black, at times strong."""
    color = dice.pick([WHITE, WHITE, srgb(215, 212, 205), srgb(150, 150, 150), BLACK])
    if dice.chance(0.15):
        color = dice.pick(BRIGHTS)
    return plain(vary(dice, color, 0.1), dice.pick([0.0, 0.3, 0.6]), seed=dice.uniform(0, 50))


def board(dice: Dice) -> Material:
    """What cabinets, desks and shelves are built of."""
    return wood(dice) if dice.chance(0.62) else painted(dice)


def metal(dice: Dice) -> Material:
    return plain(vary(dice, dice.pick(METALS)), dice.uniform(0.8, 2.0))


def fabric(dice: Dice, color: Color | None = None) -> Material:
    color = vary(dice, color or dice.pick(FABRICS), 0.2)
    seed = dice.uniform(0, 50)
    kind = dice.uniform()
    if kind < 0.45:
        return Material(
            "weave", color, shade(color, 0.7), dice.uniform(0.006, 0.02), 0.6, seed=seed
        )
    if kind < 0.7:
        return plain(color, seed=seed)
    if kind < 0.8:
        other = dice.pick(FABRICS)
        return Material("stripes", color, other, dice.uniform(0.03, 0.15), 0.8, seed=seed)
    if kind < 0.9:
        return Material("plaid", color, dice.pick(FABRICS), dice.uniform(0.06, 0.2), 0.7, seed=seed)
    return Material("damask", color, dice.pick(FABRICS), dice.uniform(0.05, 0.2), 0.7, seed=seed)


def leather(dice: Dice) -> Material:
    color = dice.pick([srgb(60, 40, 30), srgb(35, 33, 33), srgb(120, 75, 48), srgb(200, 190, 172)])
    return Material("damask", color, shade(color, 0.85), 0.03, 0.25, 0.35, seed=dice.uniform(0, 50))


def ceramic(dice: Dice) -> Material:
    return plain(vary(dice, dice.pick([WHITE, WHITE, WHITE, srgb(225, 215, 195)]), 0.05), 0.8)


def stone(dice: Dice) -> Material:
    """Worktops: granite, marble or laminate."""
    color = dice.pick([
        srgb(60, 58, 56), srgb(120, 112, 104), srgb(200, 192, 180), srgb(225, 222, 216),
        srgb(150, 120, 95), srgb(40, 42, 44),
    ])  # fmt: skip
    pattern = dice.pick(["speckle", "speckle", "marble", "plain"])
    second = shade(color, dice.pick([0.5, 1.6]))
    scale = dice.uniform(0.01, 0.025) if pattern == "speckle" else dice.uniform(0.2, 0.6)
    return Material(pattern, color, second, scale, 0.8, 0.6, seed=dice.uniform(0, 50))


def wall_paint(dice: Dice) -> Material:
    """About half the walls of real rooms are simply painted."""
    color = vary(dice, dice.pick(WALLS), 0.08)
    if dice.chance(0.14):
        color = vary(dice, dice.pick(STRONG_WALLS), 0.15)
    seed = dice.uniform(0, 50)
    kind = dice.uniform()
    if kind < 0.56:
        return plain(color, seed=seed)
    if kind < 0.66:
        return Material("damask", color, shade(color, 0.8), dice.uniform(0.05, 0.3), 0.5, seed=seed)
    if kind < 0.73:
        other = shade(color, dice.pick([0.7, 0.85, 1.12]))
        return Material("trellis", color, other, dice.uniform(0.06, 0.25), 0.8, seed=seed)
    if kind < 0.82:
        return Material(
            "stripes", color, shade(color, 0.85), dice.uniform(0.05, 0.25), 0.8, seed=seed
        )
    if kind < 0.92:
        return Material("speckle", color, shade(color, 0.85), 0.012, 0.5, seed=seed)
    brick = vary(dice, dice.pick([srgb(160, 90, 70), srgb(190, 180, 168), srgb(150, 110, 90)]))
    return Material("brick", brick, srgb(190, 185, 176), 0.075, 1.0, seed=seed)


def ceiling(dice: Dice) -> Material:
    """Mostly white paint; rough plaster, hung panels or boards in some rooms."""
    color, seed = vary(dice, srgb(238, 237, 233), 0.05), dice.uniform(0, 50)
    kind = dice.uniform()
    if kind < 0.6:
        return plain(color, seed=seed)
    if kind < 0.78:
        scale = dice.uniform(0.006, 0.03)
        return Material("speckle", color, shade(color, 0.8), scale, 0.6, seed=seed)
    if kind < 0.93:
        size = dice.pick([0.5, 0.6, 0.625])
        return Material(
            "panels", color, shade(color, dice.uniform(0.45, 0.75)), size, 1.0, seed=seed
        )
    boards = color if dice.chance(0.5) else vary(dice, dice.pick(WOODS), 0.15)
    return Material("planks", boards, shade(boards, 0.75), dice.uniform(0.08, 0.14), 0.8, seed=seed)


def panelling(dice: Dice) -> Material:
    """The lower part of some walls: tiles, boards or a stronger paint."""
    kind = dice.uniform()
    if kind < 0.4:
        return wall_tiles(dice)
    color = vary(dice, dice.pick(WOODS + [WHITE] * 6 + STRONG_WALLS), 0.12)
    if kind < 0.75:
        scale = dice.uniform(0.08, 0.14)
        return Material(
            "planks", color, shade(color, 0.75), scale, 0.7, 0.2, seed=dice.uniform(0, 50)
        )
    return plain(color, 0.1, seed=dice.uniform(0, 50))


def wall_tiles(dice: Dice) -> Material:
    color = vary(dice, dice.pick([
        WHITE, srgb(220, 226, 226), srgb(170, 196, 200), srgb(210, 196, 170), srgb(120, 140, 150),
    ]), 0.08)  # fmt: skip
    size, seed = dice.pick([0.1, 0.15, 0.2, 0.3]), dice.uniform(0, 50)
    joint = shade(color, dice.pick([0.5, 0.7, 1.15]))
    if dice.chance(0.3):  # bricks of glazed clay, as in kitchens and stations
        return Material("brick", color, joint, 0.6 * size, 0.6, 0.5, seed=seed)
    return Material("tiles", color, joint, size, 0.8, 0.5, seed=seed)


def floor(dice: Dice, wet: bool = False) -> Material:
    """Planks, carpet, tiles or lino; rooms with water never have carpet."""
    seed = dice.uniform(0, 50)
    kind = dice.uniform(0.55, 1.0) if wet else dice.uniform()
    if kind < 0.45:
        color = vary(dice, dice.pick(WOODS), 0.2)
        gloss = dice.pick([0.2, 0.5, 0.9, 1.2])
        return Material(
            "planks", color, shade(color, 0.62), dice.uniform(0.07, 0.16), 1.0, gloss, 0.0, seed
        )
    if kind < 0.72 and not wet:
        color = vary(dice, dice.pick(FABRICS[:6] + FABRICS[13:16]), 0.2)
        return Material("carpet", color, shade(color, 0.6), 0.01, 0.8, seed=seed)
    if kind < 0.93:
        color = vary(dice, dice.pick([
            srgb(200, 190, 172), srgb(160, 150, 140), srgb(225, 222, 216), srgb(120, 110, 104),
            srgb(190, 160, 130), srgb(150, 100, 75),
        ]))  # fmt: skip
        size = dice.pick([0.15, 0.2, 0.3, 0.33, 0.45, 0.6])
        return Material(
            "tiles", color, shade(color, 0.55), size, 1.0, dice.pick([0.2, 0.6, 1.2]), 0.0, seed
        )
    color = vary(dice, dice.pick([srgb(170, 165, 155), srgb(140, 145, 140), srgb(190, 180, 160)]))
    return Material("speckle", color, shade(color, 0.7), 0.015, 0.5, 0.5, 0.0, seed)
