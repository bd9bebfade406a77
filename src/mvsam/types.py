"""The nouns of the package: what a picture, a scene, a model's input and a model's output are.

Conventions that hold everywhere (docs/conventions.md): metres; camera axes x right, y down,
z forward; the image covers [0, W] x [0, H], so the first pixel's centre is (0.5, 0.5); depth is z
along the optical axis with 0 = unknown; labels are 0..K-1 with `IGNORE` = 255. View 0 is the
reference, and the paper's M counts it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Int, UInt8
from torch import Tensor, nn

IGNORE = 255
"""Label of a pixel that belongs to no class; losses and scores leave it out."""


@dataclass(frozen=True)
class Frame:
    """One posed picture; pixels are read when asked for, so listing a scene stays cheap."""

    name: str
    size: tuple[int, int]
    """(width, height) of the picture, pixels."""
    intrinsics: Float[np.ndarray, "3 3"]
    """Pixels of this picture, corner convention (an OpenCV calibration plus 0.5)."""
    world_from_cam: Float[np.ndarray, "4 4"]
    load_image: Callable[[], np.ndarray] = field(repr=False)
    load_depth: Callable[[], np.ndarray] | None = field(default=None, repr=False)
    load_labels: Callable[[], np.ndarray] | None = field(default=None, repr=False)

    @property
    def image(self) -> UInt8[np.ndarray, "height width 3"]:
        """RGB."""
        return self.load_image()

    @property
    def depth(self) -> Float[np.ndarray, "height width"] | None:
        """Metres along the optical axis, 0 = unknown."""
        return self.load_depth() if self.load_depth else None

    @property
    def labels(self) -> UInt8[np.ndarray, "height width"] | None:
        """0..K-1, `IGNORE` elsewhere."""
        return self.load_labels() if self.load_labels else None


@runtime_checkable
class Scene(Protocol):
    """Anything that can list frames of one rigid place in one world frame."""

    @property
    def name(self) -> str: ...

    def __len__(self) -> int: ...

    def frame(self, index: int) -> Frame: ...

    def views(self) -> Sequence[tuple[int, ...]] | None:
        """View tuples the scene itself prescribes (reference, then sources), or None."""
        ...


class _TensorStruct:
    """Device moves for dataclasses whose fields are tensors or None."""

    def to(self, *args, **kwargs):
        """A copy with every tensor moved, as `Tensor.to`."""
        moved = {
            f.name: value.to(*args, **kwargs)
            for f in fields(self)  # pyright: ignore[reportArgumentType]
            if isinstance(value := getattr(self, f.name), Tensor)
        }
        return replace(self, **moved)  # pyright: ignore[reportArgumentType, reportCallIssue]


@dataclass(frozen=True)
class Views(_TensorStruct):
    """M posed views of one place, a batch of them; what every model is called with."""

    images: Float[Tensor, "batch view 3 height width"]
    """RGB in [0, 1]; models normalise for themselves."""
    intrinsics: Float[Tensor, "batch view 3 3"]
    """Pixels of *these* images, corner convention."""
    world_from_cam: Float[Tensor, "batch view 4 4"]
    """The paper's (R_i, t_i)."""
    depth_range: Float[Tensor, "batch 2"]
    """(d_min, d_max), metres."""
    measured_depth: Float[Tensor, "batch height width"] | None = None
    """Sensor depth of view 0, for RGB-D models only; 0 = unknown."""
    semantic_images: Float[Tensor, "batch view 3 semantic_height semantic_width"] | None = None
    """The same views at another size for the semantic encoder; None: it sees `images`."""

    @property
    def num_views(self) -> int:
        return self.images.shape[1]

    @property
    def height(self) -> int:
        return self.images.shape[-2]

    @property
    def width(self) -> int:
        return self.images.shape[-1]

    def with_reference(self, reference: int) -> "Views":
        """The same views, this one first; without the measured depth, which is another's.

        ValueError for a number that no view has.
        """
        views = self.select(self.reference_first(reference))
        return replace(views, measured_depth=None) if reference else views

    def reference_first(self, reference: int) -> list[int]:
        """Every view once, this one first; ValueError for a number that no view has."""
        if reference not in range(self.num_views):
            raise ValueError(f"reference {reference} of views 0 to {self.num_views - 1}")
        return [reference, *(i for i in range(self.num_views) if i != reference)]

    def select(self, order: list[int]) -> "Views":
        """These views, in this order; the measured depth stays that of view 0."""
        semantic = self.semantic_images
        return replace(
            self,
            images=self.images[:, order],
            intrinsics=self.intrinsics[:, order],
            world_from_cam=self.world_from_cam[:, order],
            semantic_images=None if semantic is None else semantic[:, order],
        )


@dataclass(frozen=True)
class Targets(_TensorStruct):
    """Ground truth of the reference view."""

    depth: Float[Tensor, "batch height width"]
    """z-depth in metres, 0 = unknown."""
    labels: Int[Tensor, "batch height width"]
    """0..K-1, `IGNORE` = no label."""


@dataclass(frozen=True)
class DepthStage(_TensorStruct):
    """One stage of the cascade: a depth distribution over per-pixel hypotheses."""

    hypotheses: Float[Tensor, "batch plane stage_height stage_width"]
    """Metres."""
    probability: Float[Tensor, "batch plane stage_height stage_width"]
    """Sums to one over the planes."""
    depth: Float[Tensor, "batch stage_height stage_width"]
    """Expectation over the planes, metres (Eq. 3); TransMVSNet's: the most probable plane."""
    confidence: Float[Tensor, "batch stage_height stage_width"]
    """Probability mass of the four planes around the expectation (baselines: their own)."""


@dataclass(frozen=True)
class DepthPrior(_TensorStruct):
    """What one picture alone says about depth: Laplace's distribution of its logarithm."""

    log_median: Float[Tensor, "batch h4 w4"]
    """Of metres."""
    log_precision: Float[Tensor, "batch h4 w4"]
    """Precision is one over the mean deviation of the logarithm of depth from its median."""


@dataclass(frozen=True)
class Prediction:
    """What a model says about the reference view; a task it does not have is None."""

    depth: Float[Tensor, "batch height width"] | None = None
    """Metres."""
    confidence: Float[Tensor, "batch height width"] | None = None
    """0..1; of a cascade `mvs.cascade.combined_confidence`."""
    logits: Float[Tensor, "batch num_classes height width"] | None = None
    """Before the softmax."""
    stages: list[DepthStage] = field(default_factory=list)
    """Coarse to fine; for the loss and for inspection."""
    prior: DepthPrior | None = None
    """What the first stage began with; None where the model has no `MonocularPrior`."""
    auxiliary: "tuple[Prediction, ...]" = ()
    """Side outputs that training supervises, in the order their publication lists them, each at
    its own resolution."""

    @property
    def labels(self) -> Int[Tensor, "batch height width"] | None:
        """The most likely class of each pixel."""
        return None if self.logits is None else torch.argmax(self.logits, dim=1)


@runtime_checkable
class EncodesViews(Protocol):
    """A `Model` that looks at each view by itself first, so that no photo is encoded twice.

    What `encode` returns is a dataclass of tensors with a static `join`, which puts views that were
    encoded apart side by side; `model.MultiViewSAM` says more.
    """

    def encode(self, views: Views) -> Any: ...

    def decode(self, features: Any, views: Views, reference: int = 0) -> Prediction: ...


class Model(nn.Module):
    """What every model is, ours and each baseline: called as `model(views)`, it predicts view 0.

    One whose parameters learn at different rates has `parameter_groups(lr)`, the list of dicts that
    torch's optimisers take. See `EncodesViews` too.
    """

    info: Any = None
    """What the weights' file says of itself (`weights.WeightsInfo`); None for random weights."""
    input_size: tuple[int, int] = (320, 256)
    """(width, height) that photos are resized to, pixels: what it was trained with."""
    semantic_size: tuple[int, int] | None = None
    """(width, height) of `Views.semantic_images` it was trained with; None: without them."""
    weights_hash: str | None = None
    """Of the weights' file."""
    num_classes: int = 20
    """The paper's K; without meaning where the model has no semantics."""
    reads_depth: bool = False
    """Whether it needs `Views.measured_depth`."""
    backbone_weights: str = "random"
    """What its backbone began with: random, imagenet or the name of a file."""

    def forward(self, views: Views) -> Prediction:
        raise NotImplementedError
