"""TransMVSNet (Ding et al., CVPR 2022): the frame of CasMVSNet, with transformed features.

Deformable heads of the pyramid, attention within and between views on its coarsest level,
similarity in place of variance, and the most probable plane in place of the expectation.
1,148,924 parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torchvision.ops import deform_conv2d

from mvsam.baselines.feature_matching import FeatureMatchingTransformer
from mvsam.convolution import conv_bn_relu
from mvsam.encoders.fpn import FeaturePyramid
from mvsam.geometry.camera import scale_intrinsics
from mvsam.geometry.warp import source_from_reference_pixels, warp_to_reference
from mvsam.loss_terms import depth_at, is_depth_known
from mvsam.mvs.cascade import DepthCascade
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.types import DepthStage, Model, Prediction, Targets, Views

CHANNELS = (32, 16, 8)
"""Of the pyramid, coarse to fine."""


class DeformableConv(nn.Module):
    """Modulated deformable 3x3 convolution (Zhu et al., CVPR 2019), one group.

    Offsets begin at 0 and the mask at a half, so at first it is half a convolution plus bias.
    """

    def __init__(self, in_channels: int, out_channels: int):
        super().__init__()
        self.offset_and_mask = nn.Conv2d(in_channels, 27, 3, padding=1)
        nn.init.zeros_(self.offset_and_mask.weight)
        nn.init.zeros_(self.offset_and_mask.bias)  # pyright: ignore[reportArgumentType]
        bound = 1 / sqrt(9 * in_channels)
        weight = torch.empty(out_channels, in_channels, 3, 3).uniform_(-bound, bound)
        self.weight = nn.Parameter(weight)
        self.bias = nn.Parameter(torch.zeros(out_channels))

    def forward(
        self, x: Float[Tensor, "images channel height width"]
    ) -> Float[Tensor, "images _channels height width"]:
        offset, mask = self.offset_and_mask(x).float().split([18, 9], dim=1)
        sampled = deform_conv2d(
            x.float(), offset, self.weight, self.bias, padding=(1, 1), mask=torch.sigmoid(mask)
        )
        return sampled.to(x.dtype)


def adaptive_head(out_channels: int, kernel_size: int, width: int = 32) -> nn.Sequential:
    """The "adaptive receptive field": one convolution, then three deformable ones."""
    return nn.Sequential(
        conv_bn_relu(width, width, kernel_size),
        DeformableConv(width, width),
        nn.BatchNorm2d(width),
        nn.ReLU(inplace=True),
        DeformableConv(width, width),
        nn.BatchNorm2d(width),
        nn.ReLU(inplace=True),
        DeformableConv(width, out_channels),
    )


class TransformedPathway(nn.Module):
    """Brings the transformed coarsest level down to the finer ones, view by view."""

    def __init__(self, channels: Sequence[int] = CHANNELS):
        super().__init__()
        pairs = list(pairwise(channels))
        self.reduce = nn.ModuleList(nn.Conv2d(a, b, 1, bias=False) for a, b in pairs)
        self.smooth = nn.ModuleList(nn.Conv2d(b, b, 3, padding=1, bias=False) for _, b in pairs)

    def forward(
        self, pyramid: Sequence[Float[Tensor, "images _channel _height _width"]]
    ) -> list[Float[Tensor, "images _channel _height _width"]]:
        """Coarse to fine, as given."""
        levels = [pyramid[0]]
        for reduce, smooth, level in zip(self.reduce, self.smooth, pyramid[1:], strict=True):
            size = level.shape[-2:]
            coarser = F.interpolate(reduce(levels[-1]), size, mode="bilinear", align_corners=False)
            levels.append(smooth(coarser + level))
        return levels


class TransMVSNet(Model):
    """Depth of view 0; trained by `TransMVSNetLoss`, for the depth itself has no gradient."""

    def __init__(self):
        super().__init__()
        heads = [adaptive_head(c, k) for c, k in zip(CHANNELS, (1, 3, 3), strict=True)]
        self.pyramid = FeaturePyramid(heads=heads)
        self.transformer = FeatureMatchingTransformer(CHANNELS[0])
        self.pathway = TransformedPathway()
        self.planes = DepthCascade([CostRegularizer(1) for _ in CHANNELS])
        self.visibility = nn.Sequential(
            conv1x1x1_bn_relu(1, 16), conv1x1x1_bn_relu(16, 8), nn.Conv3d(8, 1, 1)
        )

    def forward(self, views: Views) -> Prediction:
        """Depth and confidence at the picture's size; sides must be divisible by 32.

        Raises ValueError without a source view.
        """
        if views.num_views < 2:
            raise ValueError("TransMVSNet needs a source view beside the reference")
        stages: list[DepthStage] = []
        weights: list[Tensor] = []
        for index, features in enumerate(self.features(views)):
            size = features.shape[-2:]
            hypotheses = self.planes.hypotheses(index, stages, size, views)
            similarities = source_similarities(features, views, hypotheses)
            if index == 0:
                weights = [torch.sigmoid(self.visibility(s)).amax(2) for s in similarities]
            else:
                weights = [F.interpolate(w.detach(), size, mode="nearest") for w in weights]
            volume = weighted_mean(similarities, weights)
            stages.append(winner_takes_all(self.planes.regularizers[index](volume), hypotheses))
        return Prediction(stages[-1].depth, stages[-1].confidence, stages=stages)

    def features(self, views: Views) -> list[Float[Tensor, "batch view _channel _height _width"]]:
        """The pyramid of every view, coarse to fine, transformed with view 0 as reference."""
        shape = views.images.shape[:2]
        coarse, *finer = self.pyramid(views.images.flatten(0, 1))
        coarse = self.transformer(coarse.unflatten(0, shape)).flatten(0, 1)
        return [level.unflatten(0, shape) for level in self.pathway([coarse, *finer])]


def conv1x1x1_bn_relu(in_channels: int, out_channels: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(in_channels, out_channels, 1, bias=False),
        nn.BatchNorm3d(out_channels),
        nn.ReLU(inplace=True),
    )


def source_similarities(
    features: Float[Tensor, "batch view channel height width"],
    views: Views,
    hypotheses: Float[Tensor, "batch plane height width"],
) -> list[Float[Tensor, "batch 1 plane height width"]]:
    """Of each source view: mean over the channels of its warped features times the reference's."""
    height, width = features.shape[-2:]
    intrinsics = scale_intrinsics(views.intrinsics, width / views.width, height / views.height)
    reference = features[:, 0, :, None].float()
    similarities = []
    for view in range(1, views.num_views):
        linear, offset = source_from_reference_pixels(intrinsics, views.world_from_cam, view)
        warped = warp_to_reference(features[:, view].float(), linear, offset, hypotheses)
        similarities.append((warped * reference).mean(1, keepdim=True))
    return similarities


def weighted_mean(
    similarities: Sequence[Float[Tensor, "batch 1 plane height width"]],
    weights: Sequence[Float[Tensor, "batch 1 height width"]],
) -> Float[Tensor, "batch 1 plane height width"]:
    """Mean over the source views by their weights; a pixel that no view sees gets 0."""
    weighted = torch.stack([s * w[:, :, None] for s, w in zip(similarities, weights, strict=True)])
    return weighted.sum(0) / (1e-5 + torch.stack(list(weights)).sum(0)[:, :, None])


def winner_takes_all(
    scores: Float[Tensor, "batch plane height width"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> DepthStage:
    """The most probable plane's depth, its probability as confidence; neither has a gradient."""
    probability = torch.softmax(scores.float(), dim=1)
    confidence, winner = probability.detach().max(dim=1, keepdim=True)
    depth = hypotheses.gather(1, winner)
    return DepthStage(hypotheses, probability, depth[:, 0], confidence[:, 0])


@dataclass(frozen=True)
class TransMVSNetLoss:
    """Cross entropy of the plane nearest to the true depth, at every stage."""

    focus: float = 0.0
    """The publication's gamma: weight (1 - P)^gamma of easy pixels; its released code has 0."""
    weight: float = 2.0
    stage_weights: tuple[float, ...] = (1.0, 1.0, 1.0)
    """Coarse to fine."""

    def __call__(
        self, prediction: Prediction, targets: Targets, depth_range: Float[Tensor, "batch 2"]
    ) -> dict[str, Float[Tensor, ""]]:
        """`loss` and its only part `depth`; true depths beyond a window belong to its edge."""
        total = targets.depth.new_zeros(())
        for stage, weight in zip(prediction.stages, self.stage_weights, strict=True):
            depth = depth_at(targets.depth, stage.depth.shape[-2:])
            total = total + weight * self._stage(stage, depth, depth_range)
        return {"loss": self.weight * total, "depth": self.weight * total.detach()}

    def _stage(self, stage: DepthStage, depth: Tensor, depth_range: Tensor) -> Tensor:
        nearest = (stage.hypotheses - depth[:, None]).abs().argmin(1, keepdim=True)
        probability = stage.probability.gather(1, nearest)[:, 0]
        errors = -((1 - probability) ** self.focus) * torch.log(probability + 1e-6)
        known = is_depth_known(depth, depth_range)
        pixels = known.sum((1, 2)).clamp(min=1)
        return (errors.where(known, 0).sum((1, 2)) / pixels).mean()
