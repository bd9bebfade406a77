"""Colours of materials where rays meet them, evaluated for many hits at a time.

Every pattern fades to its mean where a pixel covers more than its unit, as in a photograph; without
that, distant tiles would flicker from view to view.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int

from .materials import PATTERNS, Material
from .pictures import Pyramid, pyramid

_TILE = 512
_PER_CELL = 8


@dataclass(frozen=True)
class MaterialTable:
    """The materials of a room as columns."""

    pattern: Int[np.ndarray, " material"]
    color: Float[np.ndarray, "3 material"]
    second: Float[np.ndarray, "3 material"]
    scale: Float[np.ndarray, " material"]
    contrast: Float[np.ndarray, " material"]
    gloss: Float[np.ndarray, " material"]
    emission: Float[np.ndarray, " material"]
    seed: Float[np.ndarray, " material"]
    images: list["Pyramid | None"]
    """Of the pattern `image`."""


def material_table(materials: list[Material]) -> MaterialTable:
    def column(name: str) -> np.ndarray:
        return np.array([getattr(m, name) for m in materials], dtype=np.float32).T

    pattern = np.array([PATTERNS.index(m.pattern) for m in materials])
    names = ("color", "second", "scale", "contrast", "gloss", "emission", "seed")
    columns = {name: column(name) for name in names}
    images = [pyramid(m.image) if m.pattern == "image" else None for m in materials]
    return MaterialTable(pattern=pattern, images=images, **columns)


@dataclass(frozen=True)
class _Hits:
    """Hits on surfaces of one pattern, with their material's numbers gathered."""

    u: np.ndarray
    v: np.ndarray
    footprint: np.ndarray
    toward: np.ndarray
    color: np.ndarray
    second: np.ndarray
    scale: np.ndarray
    contrast: np.ndarray
    seed: np.ndarray

    def fade(self, unit: np.ndarray | float) -> np.ndarray:
        """1 where a pattern of this unit is resolved, 0 where a pixel covers most of it."""
        return np.clip(1.5 - 1.5 * self.footprint / unit, 0, 1)

    def blend(self, amount: np.ndarray) -> np.ndarray:
        """From the first colour (0) to the second (1)."""
        return self.color + (self.second - self.color) * (amount * self.contrast)


def albedo(
    table: MaterialTable,
    material: Int[np.ndarray, " hit"],
    uv: Float[np.ndarray, "2 hit"],
    footprint: Float[np.ndarray, " hit"],
    direction: Float[np.ndarray, "3 hit"],
) -> Float[np.ndarray, "3 hit"]:
    """Linear albedo; `footprint` is the size of a pixel on the surface, metres."""
    color = np.empty((3, len(material)), dtype=np.float32)
    pattern = table.pattern[material]
    for number in np.flatnonzero(np.bincount(pattern)):
        at = np.flatnonzero(pattern == number)
        which = material[at]
        if PATTERNS[number] == "image":
            color[:, at] = _pictures(table, which, uv[:, at], footprint[at])
            continue
        u, v = uv.take(at, axis=1)
        hits = _Hits(
            u, v, footprint[at], direction.take(at, axis=1),
            table.color.take(which, axis=1), table.second.take(which, axis=1),
            table.scale[which], table.contrast[which], table.seed[which],
        )  # fmt: skip
        color[:, at] = _EVALUATE[PATTERNS[number]](hits)
    return np.clip(color, 0.0, 1.0)


def _pictures(
    table: MaterialTable, material: np.ndarray, uv: np.ndarray, footprint: np.ndarray
) -> np.ndarray:
    """Colours of hits on surfaces that show a picture."""
    color = np.empty((3, len(material)), dtype=np.float32)
    for number in np.unique(material):
        at = np.flatnonzero(material == number)
        shown, scale = table.images[number], table.scale[number]
        assert shown is not None
        color[:, at] = shown.at(uv[:, at] / scale, footprint[at] / scale)
        color[:, at] *= table.color[:, number, None]
    return color


@cache
def _noise_tile() -> np.ndarray:
    """Smooth value noise in [0, 1], periodic over 64 cells of 8 samples."""
    cells = _TILE // _PER_CELL
    values = np.random.Generator(np.random.PCG64(7)).random((cells, cells))
    step = np.arange(_TILE) / _PER_CELL
    low = step.astype(int) % cells
    high = (low + 1) % cells
    part = step - step.astype(int)
    part = part * part * (3 - 2 * part)
    rows = values[low] * (1 - part)[:, None] + values[high] * part[:, None]
    tile = rows[:, low] * (1 - part) + rows[:, high] * part
    return tile.astype(np.float32).ravel()


def _noise(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Value noise with unit cells, [0, 1]."""
    column = (x * _PER_CELL + 65536).astype(np.int32) & (_TILE - 1)
    row = (y * _PER_CELL + 65536).astype(np.int32) & (_TILE - 1)
    return _noise_tile()[row * _TILE + column]


def _cell_value(x: np.ndarray, y: np.ndarray, seed: np.ndarray) -> np.ndarray:
    """One random number in [0, 1] for each integer cell."""
    key = (x.astype(np.int32) * 73856093) ^ (y.astype(np.int32) * 19349663)
    key = (key ^ (seed * 997).astype(np.int32) * 83492791).astype(np.uint32)
    key = (key ^ (key >> np.uint32(13))) * np.uint32(1274126177)
    return ((key ^ (key >> np.uint32(16))) & np.uint32(0xFFFF)).astype(np.float32) / 65535


def _plain(h: _Hits) -> np.ndarray:
    """Paint: only a very faint unevenness."""
    slow = _noise(h.u * 1.3 + h.seed, h.v * 1.3 + h.seed) - 0.5
    fine = (_noise(h.u * 60, h.v * 60 + h.seed) - 0.5) * h.fade(0.02)
    return h.color * (1 + 0.05 * slow + 0.02 * fine)


def _wood(h: _Hits) -> np.ndarray:
    warp = _noise(h.u * 1.5 + h.seed, h.v * 6 + h.seed)
    ring = (h.v + 0.08 * warp) / h.scale
    bands = np.abs(ring * 3 + h.seed - np.floor(ring * 3 + h.seed) - 0.5) * 2
    fiber = _noise(h.u * 14 + h.seed, h.v * 260)
    amount = 0.45 * bands * h.fade(h.scale / 3) + 0.3 * warp + 0.35 * fiber * h.fade(0.006)
    return h.blend(amount)


def _planks(h: _Hits) -> np.ndarray:
    row = np.floor(h.v / h.scale + h.seed)
    along = h.u / (h.scale * 8) + _cell_value(row, row * 0, h.seed)
    column = np.floor(along)
    tone = _cell_value(column, row, h.seed)
    grain = _noise(h.u * 3 + tone * 50, h.v * 60 + tone * 50)
    fiber = _noise(h.u * 16 + tone * 30, h.v * 300) * h.fade(0.005)
    seam_v = np.abs(h.v / h.scale + h.seed - row - 0.5) > 0.5 - 0.0025 / h.scale
    seam_u = np.abs(along - column - 0.5) > 0.5 - 0.0003 / h.scale
    seam = (seam_u | seam_v) * h.fade(0.012)
    amount = 0.55 * tone + 0.3 * grain * h.fade(0.03) + 0.15 * fiber
    return h.blend(amount) * (1 - 0.5 * seam)


def _tiles(h: _Hits) -> np.ndarray:
    x, y = h.u / h.scale + h.seed, h.v / h.scale + h.seed
    column, row = np.floor(x), np.floor(y)
    tone = _cell_value(column, row, h.seed) - 0.5
    cloud = _noise(h.u * 9 + h.seed + 7 * tone, h.v * 9) - 0.5
    edge = np.maximum(np.abs(x - column - 0.5), np.abs(y - row - 0.5))
    joint = np.clip((edge - 0.5 + 0.004 / h.scale) * h.scale * 800 + 0.5, 0, 1) * h.fade(0.02)
    return h.blend(joint) * (1 + 0.12 * tone + 0.12 * cloud)


def _carpet(h: _Hits) -> np.ndarray:
    fine = _noise(h.u / h.scale, h.v / h.scale) * h.fade(h.scale * 1.5)
    middle = _noise(h.u * 22 + h.seed, h.v * 22)
    return h.blend(0.55 * fine + 0.35 * middle)


def _brick(h: _Hits) -> np.ndarray:
    y = h.v / h.scale
    row = np.floor(y)
    x = h.u / (h.scale * 3.1) + 0.5 * (row % 2)
    column = np.floor(x)
    tone = _cell_value(column, row, h.seed) - 0.5
    rough = _noise(h.u * 90, h.v * 90 + h.seed) - 0.5
    joint = (np.abs(y - row - 0.5) > 0.42) | (np.abs(x - column - 0.5) > 0.47)
    color = h.blend(joint * h.fade(0.03) + 0.18 * (1 - h.fade(0.03)))
    return color * (1 + 0.35 * tone + 0.25 * rough * h.fade(0.015))


def _stripes(h: _Hits) -> np.ndarray:
    phase = h.u / h.scale + h.seed
    wave = np.clip((np.abs(phase - np.floor(phase) - 0.5) - 0.25) * 12 + 0.5, 0, 1)
    return h.blend(0.5 + (wave - 0.5) * h.fade(h.scale / 2))


def _marble(h: _Hits) -> np.ndarray:
    x, y = h.u / h.scale, h.v / h.scale
    bend = 2 * _noise(x * 1.2 + h.seed, y * 1.2) + _noise(x * 3 + h.seed, y * 3)
    vein = np.abs(np.sin(3.1 * (x + 0.6 * y) + 3.2 * bend)) ** 0.4
    return h.blend((1 - vein) * 1.3 + 0.15 * _noise(x * 7, y * 7 + h.seed))


def _weave(h: _Hits) -> np.ndarray:
    phase = 2 * np.pi / h.scale
    thread = 0.5 + 0.25 * (np.sin(h.u * phase) + np.sin(h.v * phase)) * h.fade(h.scale / 2)
    return h.blend(0.6 * thread + 0.4 * _noise(h.u * 35 + h.seed, h.v * 35))


def _speckle(h: _Hits) -> np.ndarray:
    grain = _noise(h.u / h.scale + h.seed, h.v / h.scale)
    grain = 0.5 + (np.clip((grain - 0.5) * 3 + 0.5, 0, 1) - 0.5) * h.fade(h.scale)
    return h.blend(0.75 * grain + 0.25 * _noise(h.u * 12, h.v * 12 + h.seed))


def _plaid(h: _Hits) -> np.ndarray:
    def bars(phase):
        return (np.abs(phase - np.floor(phase) - 0.5) > 0.3) * 1.0

    cross = 0.5 * bars(h.u / h.scale + h.seed) + 0.5 * bars(h.v / h.scale)
    return h.blend(0.4 + (cross - 0.4) * h.fade(h.scale / 2))


def _damask(h: _Hits) -> np.ndarray:
    """Blots of two tones, as on wallpaper, leather or patterned cloth."""
    x, y = h.u / h.scale, h.v / h.scale
    blot = _noise(2 * x + h.seed, 2 * y + h.seed) + 0.5 * _noise(4 * x, 4 * y + h.seed)
    blot = np.clip((blot - 0.75) * 5 + 0.5, 0, 1)
    return h.blend(0.5 + (blot - 0.5) * h.fade(h.scale / 3))


def _panels(h: _Hits) -> np.ndarray:
    """Mineral panels of a hung ceiling: pin holes and dark joints."""
    x, y = h.u / h.scale + h.seed, h.v / h.scale + h.seed
    edge = np.maximum(np.abs(x - np.floor(x) - 0.5), np.abs(y - np.floor(y) - 0.5))
    joint = (edge > 0.5 - 0.008 / h.scale) * h.fade(0.02)
    holes = (_noise(h.u * 130, h.v * 130 + h.seed) > 0.72) * h.fade(0.012)
    return h.blend(np.maximum(0.8 * joint, 0.35 * holes))


def _trellis(h: _Hits) -> np.ndarray:
    """A lattice of curved lines with a dot in each cell, as on wallpaper."""
    x, y = h.u / h.scale + h.seed, h.v / h.scale + h.seed
    wave = 0.12 * np.sin(4 * np.pi * x), 0.12 * np.sin(4 * np.pi * y)
    first, second = x + y + wave[1], x - y + wave[0]
    line = np.minimum(np.abs(first - np.rint(first)), np.abs(second - np.rint(second)))
    dot = np.hypot(x - np.floor(x) - 0.5, y - np.floor(y)) < 0.11
    amount = np.maximum(np.clip((0.09 - line) * 25, 0, 1), dot)
    return h.blend(0.35 + (amount - 0.35) * h.fade(h.scale / 4))


def _rug(h: _Hits) -> np.ndarray:
    """Bands and lozenges about the middle of the cloth, whose uv origin is its centre."""
    x, y = np.abs(h.u), np.abs(h.v)
    lozenge = (np.floor((x + y) / h.scale) + np.floor((x - y + 8) / h.scale)) % 2
    fine = _noise(h.u * 120, h.v * 120 + h.seed) - 0.5
    return h.blend(0.5 + (lozenge - 0.5) * h.fade(h.scale / 2)) * (1 + 0.2 * fine)


def _painting(h: _Hits) -> np.ndarray:
    """A picture: a gradient, blobs and strokes in colours of its own; uv in [0, 1]."""
    base = np.stack(
        [0.5 + 0.5 * np.sin(h.seed * k + h.v * (1 + k % 2) * 2.5 + h.u) for k in (3.1, 5.3, 7.7)]
    )
    color = h.color + (h.second - h.color) * base
    for layer in range(5):
        key = h.seed * (1.3 + layer) + 11.7 * layer
        centre_u, centre_v = _unit(key * 1.7), _unit(key * 2.9 + 0.3)
        size = 0.08 + 0.3 * _unit(key * 4.3 + 0.7)
        wobble = 0.25 * _noise(h.u * 4 + key, h.v * 4)
        distance = np.hypot((h.u - centre_u) * (0.6 + _unit(key)), h.v - centre_v) + wobble
        inside = np.clip((size + 0.1 - distance) * 40, 0, 1)
        tint = np.stack([_unit(key * k + 0.1) for k in (6.1, 8.9, 9.7)]) ** 1.6
        tint = tint.mean(axis=0) * 0.4 + tint * 0.6
        color = color + (tint - color) * inside
    stroke = _noise(h.u * 40 + h.seed, h.v * 25) - 0.5
    return color * (1 + 0.3 * stroke * h.contrast)


def _unit(value: np.ndarray) -> np.ndarray:
    """A repeatable number in [0, 1) for each value."""
    scaled = np.sin(value * 12.9898) * 437.5453
    return scaled - np.floor(scaled)


def _outside(h: _Hits) -> np.ndarray:
    """The blurred view through a window: sky, far trees or houses; it depends on the direction."""
    x, y, z = h.toward
    flat = np.maximum(np.hypot(x, y), 1e-3)
    up = z / flat
    turn = np.arctan2(y, x)
    skyline = 0.02 + 0.35 * h.contrast * (_noise(turn * 3 + h.seed, h.seed) - 0.15)
    leaves = _noise(turn * 18 + h.seed, up * 18) * 0.6 + _noise(turn * 45, up * 45 + h.seed) * 0.4
    ground = np.clip((skyline - up) * 14 + (leaves - 0.5) * 1.6 * (h.contrast > 0.3), 0, 1)
    sky = h.color * (1 - 0.25 * np.clip(up, -0.2, 1))
    trees = h.second * (0.35 + 1.1 * leaves)
    return sky + (trees - sky) * ground


def _screen(h: _Hits) -> np.ndarray:
    """A lit display with windows on it; uv in [0, 1]."""
    column, row = np.floor(h.u * 3 + h.seed), np.floor(h.v * 4 + h.seed)
    pane = _cell_value(column, row, h.seed)
    text = (_noise(h.u * 60, np.floor(h.v * 34)) > 0.55) * h.fade(0.02) * 0.4
    return h.blend(np.clip(pane - text, 0, 1))


_EVALUATE = {
    "plain": _plain, "wood": _wood, "planks": _planks, "tiles": _tiles, "carpet": _carpet,
    "brick": _brick, "stripes": _stripes, "marble": _marble, "weave": _weave,
    "speckle": _speckle, "painting": _painting, "outside": _outside, "plaid": _plaid,
    "screen": _screen, "damask": _damask, "rug": _rug, "panels": _panels, "trellis": _trellis,
}  # fmt: skip
