"""Scenes and view tuples become `Views` and `Targets`."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch.utils.data import Dataset

from mvsam.data.catalog import open_data
from mvsam.data.lazy import LazyScenes
from mvsam.data.sampling import DepthRange, evenly_spaced, view_tuples
from mvsam.data.transforms import (
    Size,
    area_resize,
    crop_to_shape,
    resize_intrinsics,
    resize_nearest,
)
from mvsam.types import IGNORE, Frame, Scene, Targets, Views

__all__ = ["Sample", "TupleDataset", "collate", "make_targets", "make_views", "open_data"]

Sample = tuple[str, Views, Targets]
"""(scene name, batch of one, batch of one)."""


def make_views(
    frames: Sequence[Frame],
    size: Size = (320, 256),
    depth_range: DepthRange = (0.1, 5.0),
    semantic_size: Size | None = None,
) -> Views:
    """A batch of one from a reference and its sources, whole frames stretched to `size`.

    The reference's depth, where it has one, goes along for models that read sensor depth.
    semantic_size: the paper leaves open whether SAM sees the network's pictures enlarged or the
    photos themselves. We chose the former (None); (1024, 768) hands SAM each photo at that size.
    """
    photos = [frame.image for frame in frames]
    intrinsics = [resize_intrinsics(frame.intrinsics, frame.size, size) for frame in frames]
    measured = frames[0].depth
    return Views(
        images=_resized(photos, size),
        intrinsics=torch.from_numpy(np.stack(intrinsics)).float()[None],
        world_from_cam=torch.from_numpy(np.stack([f.world_from_cam for f in frames])).float()[None],
        depth_range=torch.tensor([depth_range], dtype=torch.float32),
        measured_depth=None if measured is None else _depth_tensor(measured, size),
        semantic_images=None if semantic_size is None else _resized(photos, semantic_size),
    )


def _resized(photos: Sequence[np.ndarray], size: Size) -> torch.Tensor:
    return torch.stack([area_resize(photo, size) for photo in photos])[None]


def make_targets(frame: Frame, size: Size = (320, 256)) -> Targets:
    """Ground truth of a reference at `size`; what the frame lacks is 0 or `IGNORE` everywhere."""
    width, height = size
    depth, labels = frame.depth, frame.labels
    if labels is None:
        label_tensor = torch.full((1, height, width), IGNORE)
    else:
        label_tensor = torch.from_numpy(resize_nearest(labels, size).astype(np.int64))[None]
    return Targets(
        depth=torch.zeros(1, height, width) if depth is None else _depth_tensor(depth, size),
        labels=label_tensor,
    )


def _depth_tensor(depth: np.ndarray, size: Size) -> torch.Tensor:
    return torch.from_numpy(resize_nearest(depth, size).astype(np.float32))[None]


class TupleDataset(Dataset[Sample]):
    """Every view tuple of some scenes, as batches of one.

    `tuples_per_scene` keeps at most so many of each scene, evenly spaced. `skipped` lists the
    frames ("scene: name") that no other frame overlaps, for the caller to warn about. Rooms stay
    open, because one that was dropped would be built again (about 2 MB each).
    semantic_size: as `make_views`. truth_size: of the ground truth; None: `size`.
    crop: the paper leaves open how 4:3 frames become 5:4 pictures. We chose to stretch the whole
    frame; True cuts it centrally to the shape of `size`, photos and ground truth alike.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        num_views: int = 3,
        size: Size = (320, 256),
        depth_range: DepthRange = (0.1, 5.0),
        tuples_per_scene: int | None = None,
        semantic_size: Size | None = None,
        crop: bool = False,
        truth_size: Size | None = None,
    ):
        self.scenes = scenes if isinstance(scenes, LazyScenes) else list(scenes)
        self.num_views, self.size, self.depth_range = num_views, size, depth_range
        self.truth_size = truth_size or size
        self.semantic_size, self.crop = semantic_size, crop
        self.skipped: list[str] = []
        self._items: list[tuple[int, tuple[int, ...]]] = []
        for index, scene in enumerate(self.scenes):
            tuples, skipped = view_tuples(scene, num_views, depth_range)
            self.skipped += [f"{scene.name}: {name}" for name in skipped]
            self._items += [(index, views) for views in evenly_spaced(tuples, tuples_per_scene)]

    def __len__(self) -> int:
        return len(self._items)

    def has_truth(self) -> bool:
        """Whether any tuple's reference has depth or labels."""
        references = (self.scenes[scene].frame(views[0]) for scene, views in self._items)
        return any(frame.load_depth or frame.load_labels for frame in references)

    def __getitem__(self, index: int) -> Sample:
        scene_index, views = self._items[index]
        scene = self.scenes[scene_index]
        frames = [scene.frame(view) for view in views]
        if self.crop:
            frames = [crop_to_shape(frame, self.size) for frame in frames]
        return (
            scene.name,
            make_views(frames, self.size, self.depth_range, self.semantic_size),
            make_targets(frames[0], self.truth_size),
        )


def collate(samples: Sequence[Sample]) -> tuple[list[str], Views, Targets]:
    """One batch from samples of equal size and number of views, for a `DataLoader`.

    Where some have measured depth, that of the others is 0, unknown.
    """
    names, views, targets = zip(*samples, strict=True)
    semantic = [v.semantic_images for v in views if v.semantic_images is not None]
    return (
        list(names),
        Views(
            images=torch.cat([v.images for v in views]),
            intrinsics=torch.cat([v.intrinsics for v in views]),
            world_from_cam=torch.cat([v.world_from_cam for v in views]),
            depth_range=torch.cat([v.depth_range for v in views]),
            measured_depth=_measured_depths(views),
            semantic_images=torch.cat(semantic) if len(semantic) == len(views) else None,
        ),
        Targets(
            depth=torch.cat([t.depth for t in targets]),
            labels=torch.cat([t.labels for t in targets]),
        ),
    )


def _measured_depths(views: Sequence[Views]) -> Float[torch.Tensor, "batch height width"] | None:
    depths = [v.measured_depth for v in views]
    if all(depth is None for depth in depths):
        return None
    unknown = torch.zeros(1, views[0].height, views[0].width)
    return torch.cat([unknown if depth is None else depth for depth in depths])
