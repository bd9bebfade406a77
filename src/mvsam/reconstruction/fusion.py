"""Depth and labels of a scene's photos, each photo's made better by those of its neighbours.

They are estimated from every photo and its own few sources; what neighbours estimated from others
is a second opinion on the same surfaces. What it is worth: docs/log.md, 2026-11-29.
"""

import os
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Float32, Int, UInt8

from mvsam.geometry.warp import MINIMUM_Z
from mvsam.reconstruction.filtering import Camera, few_points, neighbours
from mvsam.reconstruction.thinning import ThinnedCamera

NEIGHBOURS = 20
"""Photos whose depth maps are asked for an opinion at most."""
ROUNDS = 2
"""How often; the second time with opinions that have heard each other."""
NEAR = 0.1
"""Opinions whose logarithms of depth differ by this much count 1/e."""
AGREES = 0.05
"""The same for how far a pixel's depth is confirmed."""
UNCONFIRMED = 0.3
"""What is left of the confidence where no neighbour confirms the depth."""
LEAST_CONFIDENCE = 1e-3
"""A photo's own depth counts so much at least, so that it stays where nobody is sure."""
STEEPEST = 0.05
"""Change of the logarithm of depth from pixel to pixel; where it is larger a surface ends."""
OWN_VOTE = 1.5
"""Votes for the label that a photo gives itself; a neighbour has one at most."""
REACH = 3
"""Pixels to each side over which confirmations and votes are gathered: points land irregularly."""
LEAST_SEEN = 1e-3
"""So few neighbours are nobody."""
MOST_THREADS = 4
"""Each takes some 40 MB with 20 classes."""


class PhotoMaps(NamedTuple):
    """What is believed of a photo."""

    depth: Float32[np.ndarray, "height width"]
    """Metres, 0 = unknown."""
    confidence: Float32[np.ndarray, "height width"]
    """0..1."""
    labels: UInt8[np.ndarray, "height width"] | None = None
    """0..K-1; None where the model gives none."""


class Correction(NamedTuple):
    """What the neighbours say of a photo's maps."""

    log_ratio: Float32[np.ndarray, "height width"]
    """Logarithm of the better depth over the photo's own."""
    certainty: Float32[np.ndarray, "height width"]
    """The share of its confidence that a pixel keeps."""
    labels: UInt8[np.ndarray, "height width"] | None
    """Those with most votes."""
    is_outvoted: Bool[np.ndarray, "height width"] | None
    """Where they are not the photo's own."""

    def applied(self, own: PhotoMaps, camera: ThinnedCamera) -> PhotoMaps:
        """The better maps, at the photo's size. camera: how the corrected maps were thinned."""
        size = own.depth.shape[::-1]
        labels = own.labels
        if labels is not None and self.labels is not None and self.is_outvoted is not None:
            is_changed = camera.enlarged(self.is_outvoted.astype(np.float32), size) >= 0.5
            labels = np.where(is_changed, _enlarged_labels(self.labels, camera, size), labels)
        return PhotoMaps(
            own.depth * np.exp(camera.enlarged(self.log_ratio, size)),
            own.confidence * camera.enlarged(self.certainty, size),
            labels,
        )


def corrections(cameras: Sequence[Camera], maps: Sequence[PhotoMaps]) -> list[Correction]:
    """Of the maps of one scene, in their order, each photo's by those that see most of it.

    The maps have the cameras' sizes. Where no other photo sees a pixel, or those around it, all
    stays as it is.
    """
    samples = [few_points(camera, own.depth) for camera, own in zip(cameras, maps, strict=True)]
    near = [neighbours(cameras, samples, index, NEIGHBOURS) for index in range(len(maps))]
    believed = list(maps)

    def second_opinion(index: int) -> Correction:
        target, own = cameras[index], believed[index]
        surface = Surface(own.depth)
        return correction(
            own, (opinion(cameras[n], believed[n], target, surface) for n in near[index])
        )

    total = [np.zeros_like(own.depth) for own in maps]
    found: list[Correction] = []
    for turn in range(ROUNDS):
        if turn < ROUNDS - 1:  # one vote is enough
            believed = [own._replace(labels=None) for own in believed]
        with ThreadPoolExecutor(min(MOST_THREADS, os.cpu_count() or 1)) as pool:
            found = list(pool.map(second_opinion, range(len(maps))))
        total = [sum_ + each.log_ratio for sum_, each in zip(total, found, strict=True)]
        believed = [
            own._replace(depth=own.depth * np.exp(log_ratio))
            for own, log_ratio in zip(maps, total, strict=True)
        ]
    return [
        last._replace(log_ratio=log_ratio) for log_ratio, last in zip(total, found, strict=True)
    ]


class Opinion(NamedTuple):
    """What a photo says of another's pixels."""

    is_seen: Bool[np.ndarray, "height width"]
    """Whether it says anything of a known depth; nothing else counts elsewhere."""
    log_ratio: Float32[np.ndarray, "height width"]
    """Logarithm of its depth over the other's."""
    confidence: Float32[np.ndarray, "height width"]
    labels: UInt8[np.ndarray, "height width"] | None


class Surface:
    """A depth map that can be asked for the depth between its pixels' centres."""

    def __init__(self, depth: Float32[np.ndarray, "height width"]):
        self.is_known = depth > 0
        self._log_depth = np.log(np.maximum(depth, MINIMUM_Z))
        self._right, self._down = (_slope(self._log_depth, axis) for axis in (1, 0))

    def log_depth_at(
        self,
        pixel: Int[np.ndarray, " point"],
        right: Float[np.ndarray, " point"],
        down: Float[np.ndarray, " point"],
    ) -> Float[np.ndarray, " point"]:
        """So far from the pixel's centre, on the plane through it. pixel: counted row by row."""
        slopes = right * self._right.take(pixel) + down * self._down.take(pixel)
        return self._log_depth.take(pixel) + slopes


def opinion(source: Camera, of: PhotoMaps, target: Camera, surface: Surface) -> Opinion:
    """Of the source's points, moved into the target; where several land in one pixel, the nearest.

    surface: of the target's depth, to which a point's is compared where it lands.
    """
    x, y, depth = _seen_by(target, source, of.depth)
    width, height = target.size
    is_seen = (of.depth > 0) & (depth > MINIMUM_Z)
    is_seen &= (x >= 0) & (x < width * depth) & (y >= 0) & (y < height * depth)
    points = np.flatnonzero(is_seen)
    points = points[_nearest_last(depth.take(points))]
    depth = depth.take(points)
    x, y = x.take(points) / depth, y.take(points) / depth
    column = np.minimum(x, width - 1).astype(np.int64)
    row = np.minimum(y, height - 1).astype(np.int64)
    pixel = row * width + column

    def placed(values: np.ndarray) -> np.ndarray:
        there = np.zeros(height * width, values.dtype)
        there[pixel] = values
        return there.reshape(height, width)

    log_ratio = np.log(depth) - surface.log_depth_at(pixel, x - column - 0.5, y - row - 0.5)
    return Opinion(
        placed(surface.is_known.take(pixel)),
        placed(log_ratio.astype(np.float32)),
        placed(of.confidence.take(points)),
        None if of.labels is None else placed(of.labels.take(points)),
    )


def correction(own: PhotoMaps, opinions: Iterable[Opinion]) -> Correction:
    """By the mean of the logarithms of depth, and by majority of labels.

    Each opinion is weighted by its confidence, and by `NEAR` the more the nearer it lies to the
    photo's own; so are the votes, but for confidence, which is of depth. Certainty is lost where
    those that see a pixel do not confirm its depth.
    """
    ballot = None if own.labels is None else _Ballot(own.labels)
    total = np.maximum(own.confidence, LEAST_CONFIDENCE)
    moment, seen, confirmed = np.zeros((3, *own.depth.shape), np.float32)
    for other in opinions:
        distance = np.abs(other.log_ratio)
        nearness = other.is_seen * np.exp(-distance / NEAR)
        weight = other.confidence * nearness
        total, moment = total + weight, moment + weight * other.log_ratio
        if ballot is not None and other.labels is not None:
            ballot.add(other.labels, nearness)
        seen += other.is_seen
        confirmed += other.is_seen * np.exp(-distance / AGREES)
    seen, confirmed = _gathered(np.stack([seen, confirmed]))
    share = np.where(seen > LEAST_SEEN, confirmed / np.maximum(seen, LEAST_SEEN), 1)
    labels = None if ballot is None else ballot.winners()
    is_outvoted = None if labels is None or own.labels is None else labels != own.labels
    certainty = UNCONFIRMED + (1 - UNCONFIRMED) * share
    return Correction(moment / total, certainty, labels, is_outvoted)


class _Ballot:
    """Votes for the label of every pixel."""

    def __init__(self, own: UInt8[np.ndarray, "height width"]):
        self.own = own
        self._pixels = np.arange(own.size)
        self._votes = np.zeros((int(own.max()) + 1, own.size), np.float32)

    def add(
        self,
        labels: UInt8[np.ndarray, "height width"],
        weight: Float32[np.ndarray, "height width"],
    ) -> None:
        lacking = int(labels.max()) + 1 - len(self._votes)
        if lacking > 0:
            self._votes = np.pad(self._votes, ((0, lacking), (0, 0)))
        self._votes[labels.ravel(), self._pixels] += weight.ravel()

    def winners(self) -> UInt8[np.ndarray, "height width"]:
        """By the neighbours' votes for the pixels around, and the photo's for its own.

        What most of them see in the very pixel as the photo does stays, be it as thin as a line.
        """
        votes = _gathered(self._votes.reshape(-1, *self.own.shape))
        votes.reshape(len(votes), -1)[self.own.ravel(), self._pixels] += OWN_VOTE
        for_own = self._votes[self.own.ravel(), self._pixels]
        is_confirmed = (for_own > 0) & (for_own >= self._votes.max(axis=0))
        winners = votes.argmax(axis=0).astype(np.uint8)
        return np.where(is_confirmed.reshape(self.own.shape), self.own, winners)


def _gathered(
    maps: Float32[np.ndarray, "map height width"],
) -> Float32[np.ndarray, "map height width"]:
    """Means over a square around each pixel, as much of it as lies in the picture."""
    side = 2 * REACH + 1
    means = F.avg_pool2d(torch.from_numpy(maps)[None], side, 1, REACH, count_include_pad=False)
    return means[0].numpy()


def _nearest_last(depth: Float32[np.ndarray, " point"]) -> Int[np.ndarray, " point"]:
    """Order by 16 bits of the logarithm of depth, which NumPy sorts six times as fast."""
    if not len(depth):
        return np.zeros(0, np.int64)
    nearness = -np.log(depth)
    least, most = nearness.min(), nearness.max()
    scale = np.float32(65535) / max(most - least, np.float32(1e-6))
    return np.argsort(((nearness - least) * scale).astype(np.uint16), kind="stable")


def _slope(
    values: Float32[np.ndarray, "height width"], axis: int
) -> Float32[np.ndarray, "height width"]:
    """Change from pixel to pixel along an axis; 0 at edges, where surfaces end."""
    change = np.gradient(values, axis=axis)
    return np.where(np.abs(change) < STEEPEST, change, 0)


def _seen_by(
    target: Camera, source: Camera, depth: Float32[np.ndarray, "height width"]
) -> tuple[Float32[np.ndarray, "height width"], ...]:
    """Column times depth, row times depth, and depth of the source's pixels in the target.

    What `filtering.project` says of all of them, in float32 and without their products of matrices.
    """
    height, width = depth.shape
    column = np.arange(width, dtype=np.float32) + 0.5
    row = np.arange(height, dtype=np.float32)[:, None] + 0.5
    rotated = target.intrinsics @ target.world_from_cam[:3, :3].T
    linear = rotated @ source.world_from_cam[:3, :3] @ np.linalg.inv(source.intrinsics)
    offset = rotated @ (source.world_from_cam[:3, 3] - target.world_from_cam[:3, 3])
    rows = np.column_stack([linear, offset]).astype(np.float32)
    return tuple(depth * (a * column + b * row + c) + d for a, b, c, d in rows)


def _enlarged_labels(
    labels: UInt8[np.ndarray, "_ _"], camera: ThinnedCamera, size: tuple[int, int]
) -> UInt8[np.ndarray, "height width"]:
    """At (width, height), with borders that run between thinned pixels instead of around them."""
    if camera.step == 1:
        return labels
    best, winner = np.zeros(size[::-1], np.float32), np.zeros(size[::-1], np.uint8)
    for label in np.unique(labels):
        share = camera.enlarged((labels == label).astype(np.float32), size)
        winner[share > best] = label
        best = np.maximum(best, share)
    return winner
