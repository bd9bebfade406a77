"""Depth of one camera as another sees it."""

import numpy as np
from jaxtyping import Float


def register_depth(
    depth: Float[np.ndarray, "height width"],
    depth_intrinsics: Float[np.ndarray, "3 3"],
    intrinsics: Float[np.ndarray, "3 3"],
    color_from_depth: Float[np.ndarray, "4 4"],
    size: tuple[int, int],
) -> Float[np.ndarray, "new_height new_width"]:
    """Metres along the colour camera's axis at its (width, height); 0 where nothing lands.

    Every depth pixel is moved to the colour pixel it falls into; the nearest surface wins. Both
    intrinsics in the corner convention.
    """
    rows, columns = np.nonzero(depth > 0)
    z = depth[rows, columns].astype(np.float64)
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(z))])
    points = np.linalg.inv(depth_intrinsics) @ pixels * z
    points = color_from_depth[:3, :3] @ points + color_from_depth[:3, 3:]
    ahead = points[2] > 0
    points = points[:, ahead]
    projected = intrinsics @ points
    column = np.floor(projected[0] / projected[2])
    row = np.floor(projected[1] / projected[2])
    inside = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
    place = row[inside].astype(np.int64) * size[0] + column[inside].astype(np.int64)
    nearest = np.full(size[0] * size[1], np.inf)
    np.minimum.at(nearest, place, points[2, inside])
    nearest[np.isinf(nearest)] = 0
    return nearest.reshape(size[1], size[0]).astype(np.float32)


def read_at_pixels(
    depth: Float[np.ndarray, "height width"],
    depth_intrinsics: Float[np.ndarray, "3 3"],
    intrinsics: Float[np.ndarray, "3 3"],
    size: tuple[int, int],
) -> Float[np.ndarray, "new_height new_width"]:
    """The same viewpoint's depth at another camera's pixels, by the nearest one; 0 outside."""
    height, width = depth.shape
    columns = (np.arange(size[0]) + 0.5 - intrinsics[0, 2]) / intrinsics[0, 0]
    rows = (np.arange(size[1]) + 0.5 - intrinsics[1, 2]) / intrinsics[1, 1]
    column = np.floor(columns * depth_intrinsics[0, 0] + depth_intrinsics[0, 2]).astype(int)
    row = np.floor(rows * depth_intrinsics[1, 1] + depth_intrinsics[1, 2]).astype(int)
    seen = ((row >= 0) & (row < height))[:, None] & ((column >= 0) & (column < width))
    nearest = depth[row.clip(0, height - 1)[:, None], column.clip(0, width - 1)]
    return np.where(seen, nearest, np.float32(0))
