"""Texture pictures, read at any size without flicker."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float
from PIL import Image

_embedded: dict[str, np.ndarray] = {}


def register(key: str, pixels: np.ndarray) -> None:
    """Makes a picture that lies in no file of its own known by a name."""
    _embedded[key] = pixels


@dataclass(frozen=True)
class Pyramid:
    """A picture in linear light at full size, half of it, a quarter, ...; it repeats for ever."""

    levels: list[Float[np.ndarray, "_height _width 3"]]

    def at(
        self, places: Float[np.ndarray, "2 point"], footprint: Float[np.ndarray, " point"]
    ) -> Float[np.ndarray, "3 point"]:
        """Colours at (u, v), v upwards, the picture 1 x 1; `footprint` is a pixel's size there."""
        texels = footprint * max(self.levels[0].shape[:2])
        level = np.log2(np.maximum(texels, 1.0)).astype(np.int32)
        level = np.minimum(level, len(self.levels) - 1)
        color = np.empty((3, len(footprint)), dtype=np.float32)
        for number in np.unique(level):
            at = np.flatnonzero(level == number)
            color[:, at] = _bilinear(self.levels[number], places[:, at]).T
        return color


def _bilinear(picture: np.ndarray, places: np.ndarray) -> np.ndarray:
    height, width = picture.shape[:2]
    x, y = places[0] * width - 0.5, -places[1] * height - 0.5
    column, row = np.floor(x), np.floor(y)
    right, down = (x - column)[:, None], (y - row)[:, None]
    column, row = column.astype(np.int64), row.astype(np.int64)
    left, after = column % width, (column + 1) % width
    upper, lower = row % height, (row + 1) % height
    above = picture[upper, left] * (1 - right) + picture[upper, after] * right
    below = picture[lower, left] * (1 - right) + picture[lower, after] * right
    return above * (1 - down) + below * down


@lru_cache(maxsize=256)
def pyramid(key: str) -> Pyramid:
    """Of a picture's file, or of a picture that was registered under this name."""
    pixels = _embedded[key] if key in _embedded else np.array(Image.open(key).convert("RGB"))
    levels = [(pixels.astype(np.float32) / 255) ** np.float32(2.2)]
    while min(levels[-1].shape[:2]) >= 2:
        height, width = (side // 2 for side in levels[-1].shape[:2])
        whole = levels[-1][: 2 * height, : 2 * width]
        levels.append(whole.reshape(height, 2, width, 2, 3).mean((1, 3)))
    return Pyramid(levels)
