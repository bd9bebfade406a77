"""The cascade of Sec. 3.2: three plane sweeps, each narrower and finer than the one before."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.modules.batchnorm import _BatchNorm
from torch.utils.checkpoint import checkpoint

from mvsam.geometry.camera import scale_intrinsics
from mvsam.mvs.cost_volume import variance_volume
from mvsam.mvs.hypotheses import base_interval, plane_depths, resample_depth, window_hypotheses
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.mvs.votes import Scoring, joint_scores
from mvsam.types import DepthStage, Views

Weighing = Callable[[Tensor, Tensor], Tensor]
"""Scores and hypotheses of a stage to new scores, all (batch, plane, height, width)."""

SMOOTHING = 8
"""Pixels of the picture to each side of one that its confidence is averaged over."""


class DepthCascade(nn.Module):
    """Coarse to fine depth of view 0 from feature pyramids of all views.

    regularizers: one a stage, coarse to fine (not shared).
    num_planes: hypotheses a stage. interval_ratios: their distance in base intervals (the paper:
    48, 32, 8 at 4, 1, 0.5). num_bins: base intervals in the depth range.
    clamp: "shift" keeps refined windows at or beyond d_min; "none" lets them become negative, as
    CasMVSNet's code does (the paper is silent).
    first_scores: how stage 0 is scored, `joint_scores` or `voted_scores` (not in the paper).
    checkpoint_stages: while training, keep no volume for the backward pass, which sweeps and
    regularizes each stage again: less memory, another forward pass of time, the same gradients.
    """

    def __init__(
        self,
        regularizers: Sequence[CostRegularizer],
        num_planes: Sequence[int] = (48, 32, 8),
        interval_ratios: Sequence[float] = (4.0, 1.0, 0.5),
        num_bins: int = 192,
        clamp: Literal["shift", "none"] = "shift",
        first_scores: Scoring = joint_scores,
        checkpoint_stages: bool = False,
    ):
        super().__init__()
        if not len(regularizers) == len(num_planes) == len(interval_ratios):
            raise ValueError(
                f"a cascade needs as many regularizers ({len(regularizers)}) as plane counts "
                f"({len(num_planes)}) and interval ratios ({len(interval_ratios)})"
            )
        self.regularizers = nn.ModuleList(regularizers)
        self.num_planes = tuple(num_planes)
        self.interval_ratios = tuple(interval_ratios)
        self.num_bins = num_bins
        self.clamp = clamp
        self.first_scores = first_scores
        self.checkpoint_stages = checkpoint_stages

    def extra_repr(self) -> str:
        return (
            f"num_planes={self.num_planes}, interval_ratios={self.interval_ratios}, "
            f"num_bins={self.num_bins}, clamp={self.clamp}, "
            f"first_scores={self.first_scores.__name__}"
        )

    def forward(
        self,
        pyramid: Sequence[Float[Tensor, "batch view _channel _h _w"]],
        views: Views,
        weigh: Weighing | None = None,
    ) -> list[DepthStage]:
        """One `DepthStage` for each level of the pyramid, coarse to fine.

        weigh: makes of the scores of stage 0, given its hypotheses, the scores that count.
        """
        stages: list[DepthStage] = []
        for index, features in enumerate(pyramid):
            hypotheses = self.hypotheses(index, stages, features.shape[-2:], views)
            intrinsics = scale_intrinsics(
                views.intrinsics,
                features.shape[-1] / views.width,
                features.shape[-2] / views.height,
            )
            sweep = (features, intrinsics, views.world_from_cam, hypotheses)
            scores = self.scores(index, *sweep)
            if index == 0 and weigh is not None:
                scores = weigh(scores.float(), hypotheses)
            stages.append(regress(scores, hypotheses))
        return stages

    def scores(
        self,
        index: int,
        features: Float[Tensor, "batch view channel height width"],
        intrinsics: Float[Tensor, "batch view 3 3"],
        world_from_cam: Float[Tensor, "batch view 4 4"],
        hypotheses: Float[Tensor, "batch plane height width"],
    ) -> Float[Tensor, "batch plane height width"]:
        """Of each hypothesis, before the softmax over planes."""
        regularizer = self.regularizers[index]
        scores_of = self.first_scores if index == 0 else joint_scores

        def score(features: Tensor) -> Tensor:
            sweep = (features, intrinsics, world_from_cam, hypotheses)
            return scores_of(variance_volume, regularizer, *sweep)

        if not (self.checkpoint_stages and torch.is_grad_enabled()):
            return score(features)
        return checkpoint(
            score,
            features,
            use_reentrant=False,
            preserve_rng_state=False,
            context_fn=lambda: (nullcontext(), _statistics_left_alone(regularizer)),
        )

    def hypotheses(
        self, index: int, stages: Sequence[DepthStage], size: Sequence[int], views: Views
    ) -> Float[Tensor, "batch plane height width"]:
        """Planes over the whole range for stage 0, then windows around the previous depth."""
        num_planes, (height, width) = self.num_planes[index], size
        if index == 0:
            planes = plane_depths(views.depth_range, num_planes)
            return planes[:, :, None, None].expand(-1, -1, height, width)
        previous = stages[-1].depth.detach()
        centre = resample_depth(previous, (views.height, views.width), (height, width))
        interval = base_interval(views.depth_range, self.num_bins)
        half_width = interval * (num_planes * self.interval_ratios[index] / 2)
        nearest = views.depth_range[:, 0] if self.clamp == "shift" else None
        return window_hypotheses(centre, half_width, num_planes, nearest)


@contextmanager
def _statistics_left_alone(module: nn.Module) -> Iterator[None]:
    """Batch norms see the same batch again: their running statistics have counted it already."""
    norms = [m for m in module.modules() if isinstance(m, _BatchNorm)]
    before = [(norm.momentum, norm.num_batches_tracked) for norm in norms]
    for norm in norms:
        norm.momentum, norm.num_batches_tracked = 0.0, None
    try:
        yield
    finally:
        for norm, (momentum, count) in zip(norms, before, strict=True):
            norm.momentum, norm.num_batches_tracked = momentum, count


def regress(
    scores: Float[Tensor, "batch plane height width"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> DepthStage:
    """Softmax over the planes, then the expected depth (Eq. 3) and how peaked the mass is."""
    probability = torch.softmax(scores.float(), dim=1)
    depth = (probability * hypotheses).sum(dim=1)
    with torch.no_grad():
        confidence = four_plane_mass(probability)
    return DepthStage(hypotheses, probability, depth, confidence)


def four_plane_mass(
    probability: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch height width"]:
    """Probability of the four planes around the expected plane index, 0..1 (CasMVSNet)."""
    num_planes = probability.shape[1]
    index = torch.arange(num_planes, device=probability.device, dtype=probability.dtype)
    expected = (probability * index[:, None, None]).sum(dim=1)  # no matmul: autocast would round it
    planes = expected.long()[:, None] + torch.arange(-1, 3, device=index.device)[:, None, None]
    is_plane = (planes >= 0) & (planes < num_planes)
    around = probability.gather(1, planes.clamp(0, num_planes - 1))
    return (around * is_plane).sum(dim=1).clamp(max=1)


def combined_confidence(
    stages: Sequence[DepthStage], size: tuple[int, int]
) -> Float[Tensor, "batch height width"]:
    """Product of the four-plane mass of the stages but the last, smoothed, at `size`; 0..1.

    The last stage searches so few planes, so close together, that its mass hardly tells right from
    wrong (docs/log.md); a single stage speaks for itself.
    """
    maps = [smoothed(stage.confidence, size) for stage in stages[:-1] or stages]
    return torch.stack(maps).prod(dim=0)


def smoothed(
    confidence: Float[Tensor, "batch _height _width"], size: tuple[int, int]
) -> Float[Tensor, "batch height width"]:
    """Mean over a square of some 16 pixels of the picture a side, at the picture's `size`.

    Whether a match is right is the same for neighbours, what the mass says of each is noisy.
    """
    reach = SMOOTHING * confidence.shape[-1] // size[1]
    means = F.avg_pool2d(
        confidence[:, None], 2 * reach + 1, stride=1, padding=reach, count_include_pad=False
    )
    return F.interpolate(means, size, mode="bilinear", align_corners=False)[:, 0]
