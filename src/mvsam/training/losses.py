"""Eq. 4: cross entropy plus alpha times the smooth L1 of every stage of the cascade."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from mvsam.types import IGNORE, DepthStage, Prediction, Targets


@dataclass(frozen=True)
class LossConfig:
    """Weights and shape of the joint loss."""

    alpha: float = 1.0
    """Weight of the depth loss (Sec. 4.1: 1)."""
    beta: float = 0.02
    """Metres; where smooth L1 turns from square to straight (Sec. 4.1: 2 cm)."""
    stage_weights: tuple[float, ...] = (0.5, 1.0, 2.0)
    """Coarse to fine. The paper is silent; these are CasMVSNet's."""


def depth_loss(
    stages: Sequence[DepthStage],
    depth: Float[Tensor, "batch height width"],
    depth_range: Float[Tensor, "batch 2"],
    config: LossConfig,
) -> Float[Tensor, ""]:
    """Weighted sum over the stages of smooth L1, mean over pixels with depth inside the range.

    The ground truth comes down to each stage by the nearest pixel. 0 where no pixel is valid.
    """
    near, far = depth_range[:, 0, None, None], depth_range[:, 1, None, None]
    total = depth.new_zeros(())
    for stage, weight in zip(stages, config.stage_weights, strict=True):
        size = stage.depth.shape[-2:]
        target = F.interpolate(depth[:, None], size, mode="nearest-exact")[:, 0]
        valid = (target >= near) & (target <= far) & (target > 0)
        error = F.smooth_l1_loss(stage.depth, target, beta=config.beta, reduction="none")
        total = total + weight * _masked_mean(error, valid)
    return total


def segmentation_loss(
    logits: Float[Tensor, "batch num_classes height width"],
    labels: Int[Tensor, "batch height width"],
) -> Float[Tensor, ""]:
    """Cross entropy, mean over labelled pixels; unweighted, as the paper mentions no weights."""
    errors = F.cross_entropy(logits.float(), labels.long(), ignore_index=IGNORE, reduction="none")
    return _masked_mean(errors, labels != IGNORE)


def joint_loss(
    prediction: Prediction,
    targets: Targets,
    depth_range: Float[Tensor, "batch 2"],
    config: LossConfig,
) -> dict[str, Float[Tensor, ""]]:
    """`loss` (Eq. 4) and its parts `depth` and `segmentation`, those the model has."""
    parts: dict[str, Tensor] = {}
    if prediction.stages:
        parts["depth"] = depth_loss(prediction.stages, targets.depth, depth_range, config)
    if prediction.logits is not None:
        parts["segmentation"] = segmentation_loss(prediction.logits, targets.labels)
    if not parts:
        raise ValueError("the prediction has neither depth stages nor logits to train on")
    weights = {"depth": config.alpha, "segmentation": 1.0}
    total = torch.stack([weights[name] * value for name, value in parts.items()]).sum()
    return {"loss": total, **parts}


def _masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Mean under the mask; 0 for an empty one, still attached to the graph."""
    return (values * mask).sum() / mask.sum().clamp(min=1)
