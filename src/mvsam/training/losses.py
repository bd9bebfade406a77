"""Eq. 4: cross entropy plus alpha times the smooth L1 of every stage of the cascade."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from mvsam.loss_terms import cross_entropy, depth_at, is_depth_known, masked_mean
from mvsam.types import DepthPrior, DepthStage, Prediction, Targets


@dataclass(frozen=True)
class JointLoss:
    """Eq. 4, of which a model of one task has that task's half."""

    alpha: float = 1.0
    """Weight of the depth loss (Sec. 4.1: 1)."""
    beta: float = 0.02
    """Metres; where smooth L1 turns from square to straight (Sec. 4.1: 2 cm)."""
    stage_weights: tuple[float, ...] = (0.5, 1.0, 2.0)
    """Coarse to fine. The paper is silent; these are CasMVSNet's."""
    class_weights: tuple[float, ...] | None = None
    """Weight of each class in the cross entropy; none: all alike, as the paper mentions none."""
    within_windows: bool = False
    """Whether a stage learns only from pixels whose truth lies among its hypotheses (not in the
    paper). Of others a narrow window learns no more than which of its ends is nearer, and is drawn
    away from what it can tell."""
    plane_weight: float = 0.0
    """Metres; of the cross entropy of the first stage's planes, beside its error (not in the
    paper). The error alone asks that the mean of the planes be right, not their probabilities."""
    prior_weight: float = 0.1
    """Of the prior's negative log likelihood, where the model has a `MonocularPrior` (neither is in
    the paper)."""

    def __call__(
        self, prediction: Prediction, targets: Targets, depth_range: Float[Tensor, "batch 2"]
    ) -> dict[str, Float[Tensor, ""]]:
        """`loss` and its parts `depth` (metres), `segmentation` and `prior`, those the model has.

        depth_range: metres; depth outside it teaches nothing. Raises ValueError for a depth
        without stages, which this loss would leave untrained.
        """
        if prediction.depth is not None and not prediction.stages:
            raise ValueError("this model's depth has no stages: train it by its own method's loss")
        parts: dict[str, Tensor] = {}
        if prediction.stages:
            parts["depth"] = self.depth(prediction.stages, targets.depth, depth_range)
        if prediction.logits is not None:
            parts["segmentation"] = cross_entropy(
                prediction.logits, targets.labels, self.class_weights
            )
        if prediction.prior is not None:
            parts["prior"] = prior_loss(prediction.prior, targets.depth, depth_range)
        if not parts:
            raise ValueError("the prediction has no depth stages, logits or prior to train on")
        weights = {"depth": self.alpha, "segmentation": 1.0, "prior": self.prior_weight}
        total = torch.stack([weights[name] * value for name, value in parts.items()]).sum()
        return {"loss": total, **parts}

    def depth(
        self,
        stages: Sequence[DepthStage],
        depth: Float[Tensor, "batch height width"],
        depth_range: Float[Tensor, "batch 2"],
    ) -> Float[Tensor, ""]:
        """Weighted sum over the stages of smooth L1, mean over pixels with depth inside the range;
        with a `plane_weight`, that much of `plane_entropy` of the first as well.

        The ground truth comes down to each stage by the nearest pixel. 0 where no pixel is valid.
        """
        if len(stages) != len(self.stage_weights):
            raise ValueError(
                f"the model has {len(stages)} stages, and --loss.stage-weights gives "
                f"{len(self.stage_weights)}"
            )
        total = depth.new_zeros(())
        if self.plane_weight:
            first = stages[0]
            target = depth_at(depth, first.depth.shape[-2:])
            counts = is_depth_known(target, depth_range)
            total = total + self.plane_weight * masked_mean(plane_entropy(first, target), counts)
        for stage, weight in zip(stages, self.stage_weights, strict=True):
            target = depth_at(depth, stage.depth.shape[-2:])
            error = F.smooth_l1_loss(stage.depth, target, beta=self.beta, reduction="none")
            counts = is_depth_known(target, depth_range)
            if self.within_windows:
                counts = counts & is_within(target, stage.hypotheses)
            total = total + weight * masked_mean(error, counts)
        return total


def is_within(
    depth: Float[Tensor, "batch height width"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Bool[Tensor, "batch height width"]:
    """Where a depth lies between the nearest and the farthest hypothesis of its pixel."""
    return (depth >= hypotheses.amin(dim=1)) & (depth <= hypotheses.amax(dim=1))


def plane_entropy(
    stage: DepthStage, depth: Float[Tensor, "batch height width"]
) -> Float[Tensor, "batch height width"]:
    """Cross entropy of evenly spaced planes; the two around the depth share it by nearness."""
    interval = stage.hypotheses[:, 1] - stage.hypotheses[:, 0]
    off = (stage.hypotheses - depth[:, None]).abs() / interval[:, None]
    share = (1 - off).clamp(min=0)
    return -(share * stage.probability.clamp(min=1e-30).log()).sum(dim=1)


def prior_loss(
    prior: DepthPrior,
    depth: Float[Tensor, "batch height width"],
    depth_range: Float[Tensor, "batch 2"],
) -> Float[Tensor, ""]:
    """Negative log likelihood of the true depth, but for a constant: precise only where right."""
    target = depth_at(depth, prior.log_median.shape[-2:])
    off = (target.clamp(min=1e-3).log() - prior.log_median).abs()
    loss = prior.log_precision.exp() * off - prior.log_precision
    return masked_mean(loss, is_depth_known(target, depth_range))
