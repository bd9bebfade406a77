"""Finds out whether poses were written in another convention than camera-to-world, OpenCV axes.

Two witnesses: the overlap of the viewing frusta, which speaks only in clear cases, and a handful of
photos, which match each other best at the right poses.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float

from mvsam.data.check.likeness import THUMBNAIL, Grey, grey_thumbnail, likeness
from mvsam.data.depth_range import DepthRange
from mvsam.data.frusta import Cameras, angle_preference, frustum_overlap
from mvsam.data.transforms import resize_intrinsics
from mvsam.geometry.pose import OPENCV_FROM_OPENGL
from mvsam.types import Frame

Poses = Float[np.ndarray, "camera 4 4"]
Pair = tuple[int, int]

AS_GIVEN = "as given"


def _with_transposed_rotations(poses: Poses) -> Poses:
    result = poses.copy()
    result[:, :3, :3] = poses[:, :3, :3].transpose(0, 2, 1)
    return result


_Y_NEGATED = np.diag([1.0, -1.0, 1.0, 1.0])

READINGS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    AS_GIVEN: lambda poses: poses,
    "world-to-camera; invert them": np.linalg.inv,
    "in OpenGL axes (y up, z backward); negate their second and third column": (
        lambda poses: poses @ OPENCV_FROM_OPENGL
    ),
    "world-to-camera in OpenGL axes; invert them, then negate their second and third column": (
        lambda poses: np.linalg.inv(poses) @ OPENCV_FROM_OPENGL
    ),
    "turned the wrong way (transposed rotations); transpose the upper left 3x3 of each": (
        _with_transposed_rotations
    ),
    "left-handed (y up, z forward, as Unity's); negate their second row and their second column": (
        lambda poses: _Y_NEGATED @ poses @ _Y_NEGATED
    ),
}
"""What the poses may be, with the remedy -> the poses meant, camera-to-world in OpenCV axes."""
SIZES: dict[str, float] = {
    "meant for photos of half the size; double their first two rows": 2.0,
    "meant for photos of twice the size; halve their first two rows": 0.5,
}
"""What the intrinsics may be, with the remedy -> the factor of their first two rows."""

NUM_REFERENCES = 4
"""Photos that are matched with a neighbour."""
LEAST_MOTION = 1e-3
"""Metres."""
OFF_CENTRE, CENTRED = 0.1, 0.05
"""Of a photo's sides, that a principal point is from its middle."""
MAXIMUM_FRAMES = 200
"""Of a longer scene every second, third, ... frame is looked at."""
MARGIN = 0.06
"""Of mean correlation, by which another reading must beat the given one. On 36 scenes in each of
the first four conventions, this found the right one every time; with transposed rotations on 43 of
44 scenes, with left-handed poses on 41, with intrinsics of half the size on 23 of 31. It suspected
none of 44 right scenes."""
LEAST_CORRELATION = 0.6
"""Of photos under the reading that is proposed: on 24 sequences and 20 rooms the right poses reach
0.64 to 0.93. Where no reading is right, the best of them may reach 0.4."""


def pose_convention_hint(
    frames: Sequence[Frame], depth_range: DepthRange = (0.1, 5.0)
) -> str | None:
    """A sentence on what the poses look like and the remedy; None if they look as they should."""
    if len(frames) < 2:
        return None
    step = -(-len(frames) // MAXIMUM_FRAMES)
    frames = frames[::step]
    cameras = Cameras.of(frames)
    return (
        _hint_of_turned_photos(cameras)
        or _hint_of_units(cameras, depth_range)
        or _hint_of_overlap(cameras, depth_range)
        or _hint_of_photos(frames, cameras, depth_range)
    )


def _hint_of_turned_photos(cameras: Cameras) -> str | None:
    """Principal points far from the middle, and in the middle if width and height are exchanged."""
    centres, sizes = cameras.intrinsics[:, :2, 2], cameras.sizes
    off, off_if_turned = (np.abs(centres / s - 0.5) for s in (sizes, sizes[:, ::-1]))
    if np.median(off.min(axis=1)) < OFF_CENTRE or np.median(off_if_turned.max(axis=1)) > CENTRED:
        return None
    width, height = sizes[0].astype(int)
    return (
        f"the intrinsics look meant for photos of {height}x{width}, these are {width}x{height}; "
        "turn the photos back, or give intrinsics and poses of cameras turned with them."
    )


def _hint_of_units(cameras: Cameras, depth_range: DepthRange) -> str | None:
    """No camera moves, or all are farther from the next than a room is wide: hardly metres."""
    distances = np.linalg.norm(cameras.centres[:, None] - cameras.centres[None], axis=-1)
    if distances.max() < LEAST_MOTION:
        return (
            "the cameras do not move, all photos are less than a millimetre apart, and from one "
            "place depth cannot be told; check the translations and their unit."
        )
    np.fill_diagonal(distances, np.inf)
    nearest = float(np.median(distances.min(axis=1)))
    if nearest <= depth_range[1]:
        return None
    return (
        f"the poses look not metric, neighbouring photos are {nearest:.0f} m apart; "
        "convert the translations to metres."
    )


def _hint_of_overlap(cameras: Cameras, depth_range: DepthRange) -> str | None:
    """Views that barely overlap as given and overlap well when read otherwise."""
    overlaps = {
        reading: _typical_overlap(cameras.with_poses(meant(cameras.world_from_cam)), depth_range)
        for reading, meant in READINGS.items()
    }
    best = _best(overlaps)
    if overlaps[AS_GIVEN] > 0.1 or overlaps[best] < 0.4:
        return None
    return (
        f"the poses look {best} (views then overlap by {overlaps[best]:.0%} instead of "
        f"{overlaps[AS_GIVEN]:.0%})."
    )


def _typical_overlap(cameras: Cameras, depth_range: DepthRange) -> float:
    return float(np.median(frustum_overlap(cameras, depth_range).max(axis=1)))


def _hint_of_photos(
    frames: Sequence[Frame], cameras: Cameras, depth_range: DepthRange
) -> str | None:
    """Photos that resemble each other more when the poses are read otherwise."""
    poses = {r: cameras.with_poses(meant(cameras.world_from_cam)) for r, meant in READINGS.items()}
    # Each reading proposes pairs, so that the right one has some that truly overlap.
    pairs = sorted({pair for c in poses.values() for pair in _likely_pairs(c, depth_range)})
    sizes = {reading: _for_another_size(cameras, factor) for reading, factor in SIZES.items()}
    scores = _likeness_by_reading(frames, pairs, poses | sizes, depth_range)
    best = _best(scores)
    if scores[best] - scores[AS_GIVEN] < MARGIN or scores[best] < LEAST_CORRELATION:
        return None
    return (
        f"the {'intrinsics' if best in SIZES else 'poses'} look {best} (photos then match with a "
        f"correlation of {scores[best]:.2f} instead of {scores[AS_GIVEN]:.2f})."
    )


def _for_another_size(cameras: Cameras, factor: float) -> Cameras:
    return replace(cameras, intrinsics=cameras.intrinsics * [[factor], [factor], [1]])


def _best(scores: dict[str, float]) -> str:
    return max(scores, key=lambda reading: scores[reading])


def _likely_pairs(cameras: Cameras, depth_range: DepthRange) -> list[Pair]:
    """(reference, source) for a few references spread over the scene, by frustum overlap."""
    usefulness = frustum_overlap(cameras, depth_range) * angle_preference(cameras, depth_range)
    spread = np.linspace(0, len(cameras) - 1, NUM_REFERENCES).round().astype(int)
    return [(int(r), int(usefulness[r].argmax())) for r in np.unique(spread) if usefulness[r].any()]


def _likeness_by_reading(
    frames: Sequence[Frame],
    pairs: Sequence[Pair],
    readings: dict[str, Cameras],
    depth_range: DepthRange,
) -> dict[str, float]:
    """Mean likeness of the better half of the pairs: others may show different things."""
    grey = {index: grey_thumbnail(frames[index]) for pair in pairs for index in pair}
    scores = {}
    for reading, cameras in readings.items():
        found = [_likeness_of_pair(frames, grey, cameras, pair, depth_range) for pair in pairs]
        better_half = sorted(found, reverse=True)[: (len(found) + 1) // 2]
        scores[reading] = float(np.mean(better_half)) if found else 0.0
    return scores


def _likeness_of_pair(
    frames: Sequence[Frame],
    grey: dict[int, Grey],
    cameras: Cameras,
    pair: Pair,
    depth_range: DepthRange,
) -> float:
    reference, source = pair
    intrinsics = [
        resize_intrinsics(cameras.intrinsics[index], frames[index].size, THUMBNAIL)
        for index in pair
    ]
    return likeness(
        grey[reference],
        grey[source],
        torch.from_numpy(np.stack(intrinsics)),
        torch.from_numpy(cameras.world_from_cam[list(pair)]),
        depth_range,
    )
