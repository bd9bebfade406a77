"""MVS2D (Yang et al., CVPR 2022): multi-view stereo by 2D convolutions and epipolar attention.

A ResNet-18 looks at the reference; on the way, each pixel attends to what a second one saw along
its epipolar line in the source views. 14,852,849 parameters, multi-scale 26,256,433.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torchvision import models

from mvsam.baselines.imagenet import load_imagenet
from mvsam.baselines.mvs2d_head import InverseDepthHead, inverse_depths
from mvsam.geometry.camera import scale_intrinsics
from mvsam.geometry.warp import (
    project_hypotheses,
    sample_bilinear,
    source_from_reference_pixels,
)
from mvsam.loss_terms import masked_mean
from mvsam.types import Model, Prediction, Targets, Views

CHANNELS = (64, 128, 256, 512)
"""Of ResNet-18's four stages, at 1/4, 1/8, 1/16 and 1/32."""


class EpipolarAttention(nn.Module):
    """A reference pixel's view of the source pixels that its depth hypotheses project to.

    The query is the reference's own feature in the source branch, the keys are the sources' warped
    to each hypothesis. The values are no features: they say which hypothesis it is, and whether it
    projects into the source view.
    """

    def __init__(self, channels: int, num_depths: int = 32):
        super().__init__()
        width = channels // 4
        self.query = nn.Conv2d(channels, width, 1)
        self.key = nn.Conv2d(channels, width, 1, bias=False)
        self.depth_embedding = nn.Parameter(torch.randn(num_depths, width))
        self.visible_embedding = nn.Parameter(torch.randn(2, width))
        """For hypotheses inside and outside the source view."""
        self.from_sources = nn.Conv2d(width, channels, 1)
        self.from_reference = nn.Conv2d(channels, channels, 1)
        self.from_depth_branch = nn.Conv2d(channels, channels, 1)

    def forward(
        self,
        x: Float[Tensor, "batch channel height width"],
        features: Float[Tensor, "batch view channel height width"],
        views: Views,
        depths: Float[Tensor, "batch plane"],
        scale: float,
    ) -> Float[Tensor, "batch channel height width"]:
        """`x`, the depth branch's features, with what the source branch's say added.

        scale: factor on the sum over the source views.
        """
        reference = features[:, 0]
        query = self.query(reference).float()
        hypotheses = depths[:, :, None, None].expand(-1, -1, *x.shape[-2:])
        answers = [
            self.ask(query, self.key(features[:, view]).float(), view, views, hypotheses)
            for view in range(1, features.shape[1])
        ]
        sources = scale * torch.stack(answers).sum(0)
        result = self.from_sources(sources.to(x.dtype)) + self.from_reference(reference)
        return x + self.from_depth_branch(x) + result

    def ask(
        self,
        query: Float[Tensor, "batch width rows columns"],
        key: Float[Tensor, "batch width rows columns"],
        view: int,
        views: Views,
        hypotheses: Float[Tensor, "batch plane rows columns"],
    ) -> Float[Tensor, "batch width rows columns"]:
        """One source view's answer: the embeddings under its attention weights."""
        keys, is_visible = warp_and_look(key, view, views, hypotheses)
        scores = torch.einsum("bchw,bcphw->bphw", query, keys) / sqrt(query.shape[1])
        weights = torch.softmax(scores, dim=1)
        answer = torch.zeros_like(query)
        for mask, embedding in zip(
            (is_visible, ~is_visible), self.visible_embedding.float(), strict=True
        ):
            seen = torch.einsum("bphw,pc->bchw", weights * mask, self.depth_embedding.float())
            answer = answer + seen * embedding[:, None, None]
        return answer


def warp_and_look(
    features: Float[Tensor, "batch channel height width"],
    view: int,
    views: Views,
    hypotheses: Float[Tensor, "batch plane height width"],
) -> tuple[
    Float[Tensor, "batch channel plane height width"], Bool[Tensor, "batch plane height width"]
]:
    """A source view's features at every hypothesis of view 0, and whether they are in its image."""
    height, width = features.shape[-2:]
    intrinsics = scale_intrinsics(views.intrinsics, width / views.width, height / views.height)
    with torch.no_grad():
        linear, offset = source_from_reference_pixels(intrinsics, views.world_from_cam, view)
        coordinates, in_front = project_hypotheses(linear, offset, hypotheses)
        size = coordinates.new_tensor([width, height])
        is_visible = in_front & ((coordinates >= 0) & (coordinates <= size)).all(-1)
    return sample_bilinear(features, coordinates, in_front), is_visible


class MVS2D(Model):
    """Depth of view 0, without a confidence, as released for ScanNet; trained by `Mvs2dLoss`.

    attention_stages: stages (1 to 3) of the depth branch that attend to the sources: (1,) as
    released for ScanNet, (1, 2, 3) the multi-scale model.
    depth_range: metres; the publication's own, whatever range the views come with.
    trained_views: with other view counts the sum over the sources is scaled to this one's.
    imagenet: weights of both branches, see `load_imagenet`.
    """

    def __init__(
        self,
        attention_stages: Sequence[int] = (1,),
        depth_range: tuple[float, float] = (0.3, 10.1),
        trained_views: int = 3,
        imagenet: str | None = None,
    ):
        super().__init__()
        self.attention_stages = tuple(attention_stages)
        self.depth_range = depth_range
        self.trained_views = trained_views
        self.source_branch, _ = resnet18_stages(max(attention_stages) + 1, imagenet)
        self.depth_branch, self.backbone_weights = resnet18_stages(len(CHANNELS), imagenet)
        self.attention = nn.ModuleList(EpipolarAttention(CHANNELS[i]) for i in attention_stages)
        self.decoder = Decoder()
        self.head = InverseDepthHead(depth_range)

    def forward(self, views: Views) -> Prediction:
        """Depth in metres; sides must be divisible by 32. ValueError without a source view."""
        if views.num_views < 2:
            raise ValueError("MVS2D needs a source view beside the reference")
        near, far = self.depth_range
        depths = inverse_depths(near, far, 32).to(views.images).expand(len(views.images), -1)
        scale = (self.trained_views - 1) / (views.num_views - 1)
        seen = self._source_features(views)
        x, levels = views.images[:, 0], []
        for index, stage in enumerate(self.depth_branch):
            x = stage(x)
            if index in self.attention_stages:
                attend = self.attention[self.attention_stages.index(index)]
                x = attend(x, seen[index], views, depths, scale)
            levels.append(x)
        return Prediction(self.head(self.decoder(levels)))

    def _source_features(
        self, views: Views
    ) -> list[Float[Tensor, "batch view _channel _height _width"]]:
        """Of every view, the reference too, after each stage of the source branch."""
        x, levels = views.images.flatten(0, 1), []
        for stage in self.source_branch:
            x = stage(x)
            levels.append(x.unflatten(0, views.images.shape[:2]))
        return levels


def resnet18_stages(count: int, imagenet: str | None) -> tuple[nn.ModuleList, str]:
    """The first stages of a ResNet-18, the stem in the first; input RGB in [0, 1] as it is."""
    network = models.resnet18()
    released = models.ResNet18_Weights.IMAGENET1K_V1.get_state_dict
    weights = load_imagenet(network, imagenet, released)
    stem = nn.Sequential(network.conv1, network.bn1, network.relu, network.maxpool)
    first = nn.Sequential(stem, network.layer1)
    stages = (first, network.layer2, network.layer3, network.layer4)
    return nn.ModuleList(stages[:count]), weights


class Decoder(nn.Module):
    """From 1/32 up to 64 channels at 1/4, meeting the depth branch's features on the way."""

    def __init__(self):
        super().__init__()
        quarter, eighth, sixteenth, coarsest = CHANNELS
        self.reduce = nn.ModuleList(
            [
                nn.Conv2d(coarsest, sixteenth, 1),
                _conv3x3(sixteenth, eighth),
                _conv3x3(eighth, quarter),
            ]
        )
        self.merge = nn.ModuleList(
            [
                nn.Conv2d(2 * sixteenth, sixteenth, 1),
                _conv3x3(2 * eighth, eighth),
                _conv3x3(2 * quarter, quarter),
            ]
        )
        self.last = _conv3x3(quarter, quarter)
        # Released weights hold this layer, which nothing runs; frozen, it asks for no gradient.
        self.unused = _conv3x3(2 * quarter, quarter).requires_grad_(False)

    def forward(
        self, levels: Sequence[Float[Tensor, "batch _channel _height _width"]]
    ) -> Float[Tensor, "batch 64 quarter_height quarter_width"]:
        """Given the depth branch's features, finest first."""
        x = levels[-1]
        for reduce, merge, skip in zip(self.reduce, self.merge, levels[-2::-1], strict=True):
            x = F.interpolate(F.elu(reduce(x)), scale_factor=2, mode="nearest")
            x = F.elu(merge(torch.cat([x, skip], dim=1)))
        return F.elu(self.last(x))


def _conv3x3(in_channels: int, out_channels: int) -> nn.Conv2d:
    return nn.Conv2d(in_channels, out_channels, 3, padding=1, padding_mode="reflect")


@dataclass(frozen=True)
class Mvs2dLoss:
    """Mean absolute error over all pixels of known depth, beyond the depth range too."""

    def __call__(
        self, prediction: Prediction, targets: Targets, depth_range: Float[Tensor, "batch 2"]
    ) -> dict[str, Float[Tensor, ""]]:
        """`loss`, metres."""
        assert prediction.depth is not None
        error = (prediction.depth - targets.depth).abs()
        return {"loss": masked_mean(error, targets.depth > 0)}
