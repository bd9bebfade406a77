"""Contact sheets of rooms to look at."""

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
    """One row a scene: photograph, depth (near is warm, `max_depth` metres is dark), labels."""
    rows = [_preview_row(scene.frame(frame), palette, max_depth) for scene in scenes]
    return Image.fromarray(np.concatenate(rows, axis=0))


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
