"""How many metres one unit of a COLMAP model has, where measured depth lies beside its photos."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mvsam.data.files import load_depth
from mvsam.errors import InputError

MOST_PHOTOS = 50
FEWEST_POINTS = 50


def metres_a_unit(model: Any, images: Sequence[Any], depths: dict[str, Path]) -> float | None:
    """Median over the model's points of measured depth over the model's; None for under 50 points.

    images: of pycolmap, with poses. depths: 16-bit PNGs in millimetres, by the images' names.
    """
    measured = [image for image in images if image.name in depths]
    ratios: list[float] = []
    for image in measured[:: -(-len(measured) // MOST_PHOTOS) or 1]:
        ratios += _ratios(model, image, load_depth(depths[image.name]))
    return float(np.median(ratios)) if len(ratios) >= FEWEST_POINTS else None


def _ratios(model: Any, image: Any, depth: np.ndarray) -> list[float]:
    seen = [point for point in image.points2D if point.has_point3D()]
    if not seen:
        return []
    if any(point.point3D_id not in model.points3D for point in seen):
        raise InputError(
            f"{image.name} sees points that the COLMAP model lacks: points3D and images are not of "
            "one model, or damaged; copy both again."
        )
    world = np.array([model.points3D[point.point3D_id].xyz for point in seen])
    cam_from_world = image.cam_from_world().matrix()
    z = world @ cam_from_world[2, :3] + cam_from_world[2, 3]
    height, width = depth.shape
    pixels = np.nan_to_num([point.xy for point in seen], nan=-1)
    column, row = np.floor(pixels.clip(-1, max(width, height))).astype(int).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (z > 0)
    there = depth[row[inside], column[inside]]
    return (there / z[inside])[there > 0].tolist()
