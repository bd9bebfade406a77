"""Which depths to believe: confident ones that other photos agree with.

A wrong depth rarely repeats itself: seen from another photo it lies in front of or behind what
that photo measured. This is the geometric consistency check of multi-view stereo, with the
relative depth difference as its only tolerance.
"""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from mvsam.geometry.points import moved, to_pixels, viewing_rays


@runtime_checkable
class Camera(Protocol):
    """What projecting needs to know about a photo."""

    @property
    def size(self) -> tuple[int, int]: ...

    @property
    def intrinsics(self) -> np.ndarray: ...

    @property
    def world_from_cam(self) -> np.ndarray: ...


def back_project(
    camera: Camera, depth: Float[np.ndarray, "height width"]
) -> Float[np.ndarray, "height width 3"]:
    """World points of every pixel's centre, metres; meaningless where depth is 0."""
    width, height = camera.size
    rays = viewing_rays(*np.meshgrid(np.arange(width), np.arange(height)), camera.intrinsics)
    return moved(rays * depth[..., None], camera.world_from_cam)


def project(
    camera: Camera, points: Float[np.ndarray, "*points 3"]
) -> tuple[Float[np.ndarray, "*points 2"], Float[np.ndarray, "*points"]]:
    """Pixel coordinates (corner convention) and depth (metres) of world points.

    Behind the camera the depth is negative or zero and the pixel is infinitely far away.
    """
    rotation, centre = camera.world_from_cam[:3, :3], camera.world_from_cam[:3, 3]
    return to_pixels((points - centre) @ rotation, camera.intrinsics)


def agreement(
    points: Float[np.ndarray, "height width 3"],
    other: Camera,
    other_depth: Float[np.ndarray, "height width"],
    relative_tolerance: float,
) -> Bool[np.ndarray, "height width"]:
    """Where the world points lie at the depth that another photo measured for their pixel."""
    pixels, expected = project(other, points)
    width, height = other.size
    inside = np.all((pixels >= 0) & (pixels < (width, height)), axis=-1)
    column, row = np.where(inside[..., None], pixels, 0).astype(np.int64).transpose(2, 0, 1)
    measured = other_depth[row, column]
    close = np.abs(measured - expected) <= relative_tolerance * expected
    return inside & (measured > 0) & close


def neighbours(
    cameras: Sequence[Camera],
    points_of: Sequence[Float[np.ndarray, "_ 3"]],
    reference: int,
    most: int,
) -> list[int]:
    """The photos that see most of a photo's points, best first; at most `most`, never itself.

    `points_of[i]` are a few world points that photo i sees; who sees none has no neighbours.
    """
    if not len(points_of[reference]):
        return []
    seen = np.zeros(len(cameras))
    for index, camera in enumerate(cameras):
        pixels, _ = project(camera, points_of[reference])
        seen[index] = np.mean(np.all((pixels >= 0) & (pixels < camera.size), axis=-1))
    seen[reference] = 0
    best = np.argsort(-seen, kind="stable")[:most]
    return [int(index) for index in best if seen[index] > 0.05]


def few_points(
    camera: Camera, depth: Float[np.ndarray, "height width"]
) -> Float[np.ndarray, "point 3"]:
    """About 300 world points of a photo, enough to tell who else sees them."""
    step = max(int(np.sqrt(depth.size / 300)), 1)
    return back_project(camera, depth)[::step, ::step][depth[::step, ::step] > 0]


def trusted(
    camera: Camera,
    depth: Float[np.ndarray, "height width"],
    confidence: Float[np.ndarray, "height width"],
    others: Sequence[tuple[Camera, Float[np.ndarray, "_ _"]]],
    minimum_confidence: float,
    minimum_consistent_views: int,
    relative_tolerance: float,
) -> Bool[np.ndarray, "height width"]:
    """Pixels whose depth is known, confident, and confirmed by enough of the other photos."""
    points = back_project(camera, depth)
    votes = np.zeros(depth.shape, np.int64)
    for other, other_depth in others:
        votes += agreement(points, other, other_depth, relative_tolerance)
    return (depth > 0) & (confidence >= minimum_confidence) & (votes >= minimum_consistent_views)
