"""A truncated signed distance to the surface, on a voxel grid that exists near surfaces alone.

Curless and Levoy's volumetric fusion: every depth map says of each voxel near it how far in front
of its surface (positive) or behind it (negative) the voxel lies; the weighted mean of all says it
best, and the surface is where it is zero.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np
from jaxtyping import Bool, Float, Int

from mvsam.errors import InputError
from mvsam.reconstruction.filtering import Camera, back_project, project

EDGE = 16
"""Voxels along the edge of a block, the piece that the grid grows by."""
TRUNCATION = 4
"""Voxels; farther from a surface than this a depth map says no more than "in front"."""
TOGETHER = 64
"""Blocks that are brought up to date at once, in about 80 MB."""
MOST_BLOCKS = 100_000
"""3 GB of them: some 4,000 square metres of surface in voxels of 2 cm."""

Block = tuple[int, int, int]
"""Which block: its place in units of `EDGE` voxels."""


class TsdfVolume:
    """Depth maps in, one surface out. Memory grows with the surface, 32 KB a block."""

    def __init__(self, voxel_size: float):
        if not voxel_size > 0:
            raise InputError(f"the voxel size must be positive, not {voxel_size} m")
        self.voxel_size = voxel_size
        self.truncation = TRUNCATION * voxel_size
        self._blocks: dict[Block, np.ndarray] = {}
        """Signed distance in units of the truncation, then weight, of each block's voxels."""

    def add(
        self,
        camera: Camera,
        depth: Float[np.ndarray, "height width"],
        weight: Float[np.ndarray, "height width"],
    ) -> None:
        """Brings every voxel near the depth map up to date; depth 0 says nothing."""
        near = self._blocks_near(camera, depth)
        if len({*near, *self._blocks}) > MOST_BLOCKS:
            raise InputError(
                f"the surface takes more than {MOST_BLOCKS:,} blocks of {EDGE} voxels a side, too "
                f"many at {self.voxel_size} m a voxel: choose larger voxels"
            )
        for start in range(0, len(near), TOGETHER):
            part = near[start : start + TOGETHER]
            old = np.stack([self._block(block) for block in part])
            value, weight_here = self._observed(camera, depth, weight, self._centres(part))
            total = old[:, 1] + weight_here
            mean = old[:, 0] * old[:, 1] + value * weight_here
            np.divide(mean, total, out=old[:, 0], where=total > 0)
            old[:, 1] = total
            self._blocks.update(zip(part, map(np.copy, old), strict=True))  # not views of `old`

    def surface(self) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
        """Vertices in metres, and triangles that turn counter-clockwise to who photographed them.

        Neighbouring blocks repeat the vertices that they share. Both are empty where no surface is.
        """
        vertices, faces, count = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
        for block in self._blocks:
            corners, triangles = _zero_crossing(*self._with_next_layer(block))
            vertices.append((corners + np.multiply(block, EDGE) + 0.5) * self.voxel_size)
            faces.append(triangles + count)
            count += len(corners)
        return np.concatenate(vertices), np.concatenate(faces)

    def _blocks_near(self, camera: Camera, depth: Float[np.ndarray, "height width"]) -> list[Block]:
        """Those within the truncation of a point that the depth map shows."""
        points = back_project(camera, depth)[depth > 0]
        side = EDGE * self.voxel_size
        corners = np.array(list(product((-1, 1), repeat=3))) * self.truncation
        if not len(points):
            return []
        cells = np.concatenate([_different(np.floor((points + c) / side)) for c in corners])
        return [(int(x), int(y), int(z)) for x, y, z in _different(cells)]

    def _block(self, block: Block) -> np.ndarray:
        """Its distances and weights; of one never seen, in front of everything with no weight."""
        if block not in self._blocks:
            unseen = np.zeros((2, EDGE, EDGE, EDGE), np.float32)
            unseen[0] = 1
            return unseen
        return self._blocks[block]

    def _centres(self, blocks: Sequence[Block]) -> Float[np.ndarray, "block edge edge edge 3"]:
        """World points of the voxels' centres, metres."""
        places = np.stack(np.meshgrid(*[np.arange(EDGE)] * 3, indexing="ij"), axis=-1) + 0.5
        return (np.array(blocks)[:, None, None, None] * EDGE + places) * self.voxel_size

    def _observed(
        self, camera: Camera, depth: np.ndarray, weight: np.ndarray, centres: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """What a depth map says of world points: signed distance / truncation, and its weight.

        The weight is 0 where it says nothing: out of the picture, depth unknown, or so far behind
        what it shows that something else may be there.
        """
        pixels, distance = project(camera, centres)
        inside = np.all((pixels >= 0) & (pixels < camera.size), axis=-1)
        pixels = np.where(inside[..., None], pixels, 0)
        measured = _between_pixels(depth, pixels, most_apart=self.truncation)
        signed = (measured - distance) / self.truncation
        says = inside & (measured > 0) & (signed > -1)
        column, row = np.moveaxis(pixels.astype(np.int64), -1, 0)
        return np.minimum(signed, 1), np.where(says, weight[row, column], 0)

    def _with_next_layer(
        self, block: Block
    ) -> tuple[Float[np.ndarray, "edge edge edge"], Bool[np.ndarray, "edge edge edge"]]:
        """Distances, and where they are known, with the first voxels of the blocks that follow.

        So the cells between two blocks belong to the one before.
        """
        padded = np.ones((2, EDGE + 1, EDGE + 1, EDGE + 1), np.float32)
        padded[1] = 0
        for step in product((0, 1), repeat=3):
            there = (block[0] + step[0], block[1] + step[1], block[2] + step[2])
            to = tuple(slice(EDGE, None) if s else slice(0, EDGE) for s in step)
            of = tuple(slice(0, 1) if s else slice(0, EDGE) for s in step)
            if there in self._blocks:
                padded[:, *to] = self._blocks[there][:, *of]
        return padded[0], padded[1] > 0


def _different(cells: Float[np.ndarray, "_ 3"]) -> Float[np.ndarray, "cell 3"]:
    """Each once, sorted; by one number a cell, which sorts ten times as fast as rows."""
    low = cells.min(axis=0)
    shape = (np.ptp(cells, axis=0) + 1).astype(np.int64)
    keys = np.ravel_multi_index(tuple((cells - low).astype(np.int64).T), tuple(shape))
    return np.stack(np.unravel_index(np.unique(keys), tuple(shape)), axis=1) + low


def _between_pixels(
    depth: Float[np.ndarray, "height width"],
    pixels: Float[np.ndarray, "*points 2"],
    most_apart: float,
) -> Float[np.ndarray, "*points"]:
    """Depth at places in the picture: inverse depth, which is linear on a plane, between pixels.

    Where one of the four pixels around is unknown, or two are more than `most_apart` apart
    (metres), as at an edge, it is that of the pixel itself.
    """
    height, width = depth.shape
    first = np.floor(pixels - 0.5).astype(np.int64)
    x, y = np.moveaxis(pixels - 0.5 - first, -1, 0)
    columns = np.clip(first[..., 0] + np.array([0, 1, 0, 1])[:, *[None] * x.ndim], 0, width - 1)
    rows = np.clip(first[..., 1] + np.array([0, 0, 1, 1])[:, *[None] * x.ndim], 0, height - 1)
    around = depth[rows, columns]
    smooth = (around.min(0) > 0) & (np.ptp(around, axis=0) <= most_apart)
    shares = np.stack([(1 - x) * (1 - y), x * (1 - y), (1 - x) * y, x * y])
    between = 1 / (shares / np.where(smooth, around, 1)).sum(axis=0)
    column, row = np.moveaxis(pixels.astype(np.int64), -1, 0)
    return np.where(smooth, between, depth[row, column])


def _zero_crossing(
    distance: Float[np.ndarray, "edge edge edge"], is_known: Bool[np.ndarray, "edge edge edge"]
) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Marching cubes between known voxels; vertices in voxels, (0, 0, 0) at the first's centre."""
    nothing = np.empty((0, 3)), np.empty((0, 3), np.int64)
    known = distance[is_known]
    if not (known.size and known.min() < 0 < known.max()):
        return nothing
    from skimage.measure import marching_cubes

    vertices, faces, _, _ = marching_cubes(distance, 0.0)
    ends = np.floor(vertices).astype(np.int64), np.ceil(vertices).astype(np.int64)
    is_measured = np.logical_and(*(is_known[tuple(end.T)] for end in ends))
    return vertices, faces[is_measured[faces].all(axis=1)].astype(np.int64)
