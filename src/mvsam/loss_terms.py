"""What losses are made of, ours and each baseline's: means over the pixels whose truth is known.

A loss is a frozen dataclass whose fields are its weights. It lies beside the method it belongs to.
"""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from mvsam.types import IGNORE, Prediction, Targets


@runtime_checkable
class Loss(Protocol):
    """What a run trains by."""

    def __call__(
        self, prediction: Prediction, targets: Targets, depth_range: Float[Tensor, "batch 2"]
    ) -> dict[str, Float[Tensor, ""]]:
        """`loss`, which the gradient is of, and its parts by name."""
        ...


def masked_mean(values: Float[Tensor, "*axes"], mask: Bool[Tensor, "*axes"]) -> Float[Tensor, ""]:
    """Mean under the mask; 0 for an empty one, still attached to the graph."""
    return values.where(mask, 0).sum() / mask.sum().clamp(min=1)


def is_depth_known(
    depth: Float[Tensor, "batch height width"], depth_range: Float[Tensor, "batch 2"]
) -> Bool[Tensor, "batch height width"]:
    """Where a true depth is known and lies inside the item's own range (Sec. 4.1)."""
    near, far = depth_range[:, 0, None, None], depth_range[:, 1, None, None]
    return (depth >= near) & (depth <= far) & (depth > 0)


def depth_at(
    depth: Float[Tensor, "batch _height _width"], size: Sequence[int]
) -> Float[Tensor, "batch height width"]:
    """True depth at another (height, width), by the nearest pixel: depths must not mix."""
    return F.interpolate(depth[:, None], tuple(size), mode="nearest-exact")[:, 0]


def cross_entropy(
    logits: Float[Tensor, "batch num_classes height width"],
    labels: Int[Tensor, "batch height width"],
    class_weights: Sequence[float] | None = None,
) -> Float[Tensor, ""]:
    """Mean over labelled pixels, each counted with the weight of its class; 0 if there are none."""
    labels = labels.long()
    errors = F.cross_entropy(logits.float(), labels, ignore_index=IGNORE, reduction="none")
    labelled = labels != IGNORE
    if class_weights is None:
        return masked_mean(errors, labelled)
    if len(class_weights) != logits.shape[1]:
        raise ValueError(f"{len(class_weights)} class weights for {logits.shape[1]} classes")
    weights = errors.new_tensor(class_weights)[labels.where(labelled, 0)] * labelled
    return (weights * errors).sum() / weights.sum().clamp(min=1e-6)
