"""Does the measured depth belong to the photos' pixels, or to those of a depth camera beside?

Depth that is not registered fits itself from frame to frame, so that surfaces meet all the same.
The photos tell: carried by the right depth, one photo's detail falls on the other's same detail.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float

from mvsam.data.readers.seven_scenes import COLOR_CAMERA, COLOR_FROM_DEPTH, DEPTH_CAMERA
from mvsam.data.transforms import area_resize, resize_intrinsics, resize_nearest
from mvsam.geometry.points import moved, to_pixels, viewing_rays
from mvsam.types import Frame

SIZE = (320, 240)
"""(width, height) at which photos are compared, pixels."""
WINDOW = 31
"""Pixels; slower changes of brightness say little."""
EDGE = 0.1
"""Of width and height, not looked at: undistorted photos have borders there."""
FEWEST_POINTS = 200
MARGIN = 0.025
"""Of correlation, by which a depth camera beside must beat registered depth to be believed: on
eleven real sequences it was -0.02 to -0.19, and -0.03 to 0.11 with the depth taken from beside."""

MOST = 2 / 3
"""Of the pairs, that must gain: in a room whose photos hardly move, three of five did by chance."""


@dataclass(frozen=True)
class DepthCamera:
    """How the depth was taken, seen from the photo's camera."""

    color_from_depth: Float[np.ndarray, "4 4"]
    focal_factor: float
    """Its focal length over the photo's."""


REGISTERED = DepthCamera(np.eye(4), 1.0)
BESIDE = DepthCamera(COLOR_FROM_DEPTH, DEPTH_CAMERA[0, 0] / COLOR_CAMERA[0, 0])
"""As in a Kinect."""


def is_unregistered(frames: Sequence[Frame], pairs: Sequence[tuple[int, int]]) -> bool:
    """Whether photos match clearly better, and most pairs at all, with a depth camera beside."""
    gains = gains_of_depth_camera(frames, pairs)
    return bool(gains.mean() > MARGIN and (gains > 0).mean() >= MOST)


def gains_of_depth_camera(
    frames: Sequence[Frame], pairs: Sequence[tuple[int, int]]
) -> Float[np.ndarray, "_pair"]:
    """Correlation of two photos, if the depth is taken from beside, over that as it is given.

    Of the half of the pairs that match best either way: others may show different things.
    """
    details = {index: _detail(frames[index]) for pair in pairs for index in pair}
    found = [
        [
            _correlation(frames[r], frames[s], details[r], details[s], camera)
            for camera in (REGISTERED, BESIDE)
        ]
        for r, s in pairs
    ]
    best = sorted(found, key=max, reverse=True)[: (len(found) + 1) // 2]
    return np.array([beside - registered for registered, beside in best])


def _correlation(
    here: Frame, there: Frame, detail: np.ndarray, other: np.ndarray, camera: DepthCamera
) -> float:
    points = _points(here, camera)
    first, is_first = _at(points, detail, here)
    there_from_here = np.linalg.inv(there.world_from_cam) @ here.world_from_cam
    second, is_second = _at(moved(points, there_from_here), other, there)
    seen = is_first & is_second
    if seen.sum() < FEWEST_POINTS or not (first[seen].std() and second[seen].std()):
        return 0.0
    return float(np.corrcoef(first[seen], second[seen])[0, 1])


def _points(frame: Frame, camera: DepthCamera) -> Float[np.ndarray, "point 3"]:
    """Measured surfaces in the axes of the photo's camera, metres."""
    depth = frame.depth
    assert depth is not None
    small = resize_nearest(depth, SIZE).astype(np.float64)
    rows, columns = 2 * np.array(np.nonzero(small[::2, ::2] > 0))
    focal = np.array([[camera.focal_factor, 1, 1], [1, camera.focal_factor, 1], [1, 1, 1]])
    rays = viewing_rays(columns, rows, _intrinsics(frame) * focal)
    return moved(rays * small[rows, columns, None], camera.color_from_depth)


def _at(
    points: Float[np.ndarray, "point 3"], detail: np.ndarray, frame: Frame
) -> tuple[np.ndarray, np.ndarray]:
    """(the picture's value where each point is seen, whether it is)."""
    pixels, _ = to_pixels(points, _intrinsics(frame))
    column, row = np.floor(pixels).T
    left, top = EDGE * SIZE[0], EDGE * SIZE[1]
    seen = (column >= left) & (column < SIZE[0] - left)
    seen &= (row >= top) & (row < SIZE[1] - top)
    values = detail[np.where(seen, row, 0).astype(int), np.where(seen, column, 0).astype(int)]
    return values, seen


def _intrinsics(frame: Frame) -> Float[np.ndarray, "3 3"]:
    return resize_intrinsics(frame.intrinsics, frame.size, SIZE)


def _detail(frame: Frame) -> Float[np.ndarray, "height width"]:
    """Grey values without their slow changes."""
    grey = area_resize(frame.image, SIZE).mean(0)[None, None]
    mean = F.avg_pool2d(grey, WINDOW, stride=1, padding=WINDOW // 2, count_include_pad=False)
    return torch.squeeze(grey - mean).numpy()
