"""The depth range of a scene, from its sparse points where there are some, else from its poses."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from mvsam.data.frusta import Cameras
from mvsam.errors import InputError
from mvsam.geometry.points import to_pixels
from mvsam.types import Frame

USUAL = (0.1, 5.0)
"""Metres: what models are trained for, and what a room needs."""
DepthRange = tuple[float, float]
DepthRangeOrAuto = DepthRange | Literal["auto"]

_MARGIN = 1.25
"""Beyond the farthest thing known."""
_FEWEST_POINTS = 50


def estimate_depth_range(
    frames: Sequence[Frame], points: Float[np.ndarray, "point 3"] | None = None
) -> DepthRange:
    """(nearest, farthest) depth to expect, metres.

    points: sparse points of the scene, metres, world. With enough of them the range holds 98 % of
    those that the photos see, and a margin. Without, poses only tell that the range must reach as
    far as the photos see other cameras; it is then at least `USUAL`.
    """
    cameras = Cameras.of(frames)
    if points is not None:
        seen = depths_in_view(cameras, points)
        if len(seen) >= _FEWEST_POINTS:
            near, far = np.percentile(seen, [1, 99])
            return float(near / (2 * _MARGIN)), float(far * _MARGIN)
    ahead = depths_in_view(cameras, cameras.centres)
    farthest = _MARGIN * float(ahead.max(initial=0.0))
    return USUAL[0], max(USUAL[1], farthest)


def share_outside(
    frames: Sequence[Frame], points: Float[np.ndarray, "point 3"], depth_range: DepthRange
) -> float:
    """Share of the sparse points in view whose depth the range leaves out; 0 where they are few."""
    seen = depths_in_view(Cameras.of(frames), points)
    if len(seen) < _FEWEST_POINTS:
        return 0.0
    return float(((seen < depth_range[0]) | (seen > depth_range[1])).mean())


def depths_in_view(
    cameras: Cameras, points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, " seen"]:
    """Depth of every point in every photo that it projects into, metres."""
    found = []
    for index in range(len(cameras)):
        pose = cameras.world_from_cam[index]
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        pixels, depth = to_pixels(local, cameras.intrinsics[index])
        inside = ((pixels >= 0) & (pixels <= cameras.sizes[index])).all(axis=1)
        found.append(depth[inside])
    return np.concatenate(found)


def checked_depth_range(depth_range: Any) -> DepthRange:
    """Two numbers as (nearest, farthest), metres; `InputError` unless 0 < nearest < farthest."""
    try:
        nearest, farthest = map(float, depth_range)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"the depth range {depth_range!r} is not one; give (nearest, farthest) in metres, or "
            '"auto".'
        ) from error
    if not (np.isfinite([nearest, farthest]).all() and 0 < nearest < farthest):
        raise InputError(
            f"the depth range {nearest:g} {farthest:g} is not one; "
            "give the nearest and the farthest depth in metres, as 0.1 5.0."
        )
    return nearest, farthest
