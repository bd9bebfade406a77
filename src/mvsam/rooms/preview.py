"""Contact sheets of rooms to look at."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from mvsam.types import Frame, Scene


def preview_sheet(
    scenes: Sequence[Scene],
    palette: UInt8[np.ndarray, "num_classes 3"],
    frame: int = 0,
    max_depth: float = 5.0,
) -> Image.Image:
    """Photograph, depth (near is warm, `max_depth` metres is dark) and labels of each scene.

    The scenes fill a grid that is about as wide as high, row by row; what is left of it is black.
    """
    cells = [_preview_row(scene.frame(frame), palette, max_depth) for scene in scenes]
    height, width = cells[0].shape[:2]
    columns = max(1, round(math.sqrt(len(cells) * height / width * 4 / 3)))
    empty = [np.zeros_like(cells[0])] * (-len(cells) % columns)
    cells += empty
    rows = [np.hstack(cells[i : i + columns]) for i in range(0, len(cells), columns)]
    return Image.fromarray(np.vstack(rows))


def _preview_row(frame: Frame, palette: np.ndarray, max_depth: float) -> np.ndarray:
    colors = np.zeros((256, 3), dtype=np.uint8)
    colors[: len(palette)] = palette
    image, depth, labels = frame.image, frame.depth, frame.labels
    assert depth is not None and labels is not None
    return np.concatenate([image, _depth_colors(depth, max_depth), colors[labels]], axis=1)


def _depth_colors(depth: np.ndarray, max_depth: float) -> np.ndarray:
    stops = np.array(
        [[240, 249, 33], [248, 149, 64], [204, 71, 120], [126, 3, 168], [13, 8, 135]], dtype=float
    )
    place = np.clip(depth / max_depth, 0, 1) * (len(stops) - 1)
    channels = [np.interp(place, np.arange(len(stops)), stops[:, c]) for c in range(3)]
    return np.stack(channels, axis=-1).astype(np.uint8)
