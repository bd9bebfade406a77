"""Labelled point clouds: the trusted depths of many photos, merged per voxel."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int, UInt8

from mvsam.errors import InputError, counted
from mvsam.reconstruction.filtering import (
    back_project,
    few_points,
    neighbours,
    trusted,
)
from mvsam.reconstruction.folder import DepthView
from mvsam.reconstruction.settings import CloudSettings
from mvsam.types import IGNORE

OnPhoto = Callable[[str, float], None]
"""Called after each photo with its name and the share of its depths that passed, 0..1."""
KEY_BITS = 18
"""Bits of one voxel coordinate inside a 64-bit key, beside 8 bits of label."""


class NothingLeft(InputError):
    """No depth passes the filters."""


@dataclass(frozen=True)
class PointCloud:
    """Coloured, labelled points in the scene's world frame, metres."""

    points: Float[np.ndarray, "point 3"]
    colors: UInt8[np.ndarray, "point 3"]
    labels: UInt8[np.ndarray, "point"]
    """0..K-1, `IGNORE` = none."""
    confidence: Float[np.ndarray, "point"]
    """0..1."""

    def __len__(self) -> int:
        return len(self.points)


class VoxelGrid:
    """Sums of points per (voxel, label), so that means and majorities are exact at the end."""

    COMPACT_ABOVE = 4_000_000
    """Rows that may wait before they are merged."""

    def __init__(self, voxel_size: float):
        if not voxel_size > 0:
            raise InputError(f"the voxel size must be positive, not {voxel_size} m")
        self.voxel_size = voxel_size
        self._keys: list[np.ndarray] = []
        self._sums: list[np.ndarray] = []
        self._waiting = 0

    def add(self, cloud: PointCloud) -> None:
        """Adds points; several additions count as one of all their points."""
        columns = [
            np.ones(len(cloud)),
            *cloud.points.astype(np.float64).T,
            *cloud.colors.astype(np.float64).T,
            cloud.confidence,
        ]
        self._append(*_sum_by_key(self._key(cloud), np.stack(columns, axis=1)))
        if self._waiting > self.COMPACT_ABOVE:
            self._compact()

    def cloud(self) -> PointCloud:
        """One point per voxel: mean position, colour and confidence, majority label.

        A label wins against `IGNORE` whenever any point carries one.
        """
        self._compact()
        keys, sums = self._keys[0], self._sums[0]
        voxels, labels = keys >> 8, (keys & 0xFF).astype(np.uint8)
        votes = np.where(labels == IGNORE, 0, sums[:, 0])
        # Rows of one voxel are neighbours; the last after sorting by votes is the majority.
        order = np.lexsort((votes, voxels))
        is_last = np.append(np.diff(voxels[order]) != 0, True) if len(order) else order.astype(bool)
        _, totals = _sum_by_key(voxels, sums)
        means = totals / totals[:, :1]
        return PointCloud(
            points=means[:, 1:4].astype(np.float32),
            colors=np.round(means[:, 4:7]).astype(np.uint8),
            labels=labels[order][is_last],
            confidence=means[:, 7].astype(np.float32),
        )

    def _key(self, cloud: PointCloud) -> Int[np.ndarray, "point"]:
        half = 1 << (KEY_BITS - 1)
        cells = np.floor(cloud.points.astype(np.float64) / self.voxel_size)
        if np.any(np.abs(cells) >= half):
            raise InputError(
                f"points lie further than {half * self.voxel_size:.0f} m from the origin, "
                f"too far for voxels of {self.voxel_size} m: choose larger voxels"
            )
        x, y, z = (cells.astype(np.int64) + half).T
        voxel = (x << (2 * KEY_BITS)) | (y << KEY_BITS) | z
        return (voxel << 8) | cloud.labels

    def _append(self, keys: np.ndarray, sums: np.ndarray) -> None:
        self._keys.append(keys)
        self._sums.append(sums)
        self._waiting += len(keys)

    def _compact(self) -> None:
        keys = np.concatenate([np.empty(0, np.int64), *self._keys])
        sums = np.concatenate([np.empty((0, 8)), *self._sums])
        self._keys, self._sums, self._waiting = [], [], 0
        self._append(*_sum_by_key(keys, sums))
        self._waiting = 0


def _sum_by_key(
    keys: Int[np.ndarray, "row"], rows: Float[np.ndarray, "row column"]
) -> tuple[Int[np.ndarray, "group"], Float[np.ndarray, "group column"]]:
    """Sorted different keys and the sum of each one's rows."""
    different, group = np.unique(keys, return_inverse=True)
    sums = [np.bincount(group, column, minlength=len(different)) for column in rows.T]
    return different, np.stack(sums, axis=1).astype(np.float64)  # bincount of nothing is int


def build_cloud(
    views: Sequence[DepthView],
    settings: CloudSettings,
    on_photo: OnPhoto = lambda name, share: None,
) -> PointCloud:
    """The labelled cloud of all depths that pass the filters.

    Raises `NothingLeft` when no depth survives.
    """
    grid = VoxelGrid(settings.voxel_size)
    for view, depth in trusted_depths(views, settings, on_photo):
        grid.add(points_of(view, depth))
    cloud = grid.cloud()
    if not len(cloud):
        raise NothingLeft(f"no depth passed the filters: {remedy(views, settings)}")
    return cloud


def remedy(views: Sequence[DepthView], settings: CloudSettings) -> str:
    """What to do where the filters leave nothing."""
    if len(views) <= settings.minimum_consistent_views:
        return (
            f"no more than {counted(len(views), 'photo')} with depth can agree, take "
            f"--minimum-consistent-views {len(views) - 1}"
        )
    return "lower --minimum-confidence or --minimum-consistent-views"


def trusted_depths(
    views: Sequence[DepthView], settings: CloudSettings, on_photo: OnPhoto
) -> Iterator[tuple[DepthView, Float[np.ndarray, "height width"]]]:
    """Every photo with its depth map, metres, in which only depths that pass the filters are left.

    The others are 0. `on_photo` is called when the photo's have been used.
    """
    # Each depth is read as a reference and again as a neighbour: keep the recent ones.
    read_depth = lru_cache(maxsize=4 * settings.neighbours)(lambda index: views[index].depth())
    samples = [few_points(view, read_depth(index)) for index, view in enumerate(views)]
    for index, view in enumerate(views):
        near = neighbours(views, samples, index, settings.neighbours)
        depth = read_depth(index)
        keep = trusted(
            view,
            depth,
            view.confidence(),
            [(views[other], read_depth(other)) for other in near],
            settings.minimum_confidence,
            settings.minimum_consistent_views,
            settings.relative_tolerance,
        )
        yield view, np.where(keep, depth, 0)
        on_photo(view.photo_path.stem, float(keep.sum() / max((depth > 0).sum(), 1)))


def points_of(view: DepthView, depth: Float[np.ndarray, "height width"]) -> PointCloud:
    """What a photo says of the points that it sees: all pixels whose depth is not 0."""
    keep = depth > 0
    return PointCloud(
        points=back_project(view, depth)[keep],
        colors=view.photo()[keep],
        labels=view.labels()[keep],
        confidence=view.confidence()[keep],
    )
