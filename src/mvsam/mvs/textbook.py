"""The cascade as published code computes it: the yardstick `mvsam bench` holds ours against."""

import copy
from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from mvsam.geometry.camera import scale_intrinsics
from mvsam.mvs.cascade import DepthCascade, Weighing
from mvsam.mvs.cost_volume import textbook_variance_volume
from mvsam.mvs.votes import joint_scores
from mvsam.types import DepthStage, Views


class TextbookCascade(nn.Module):
    """The same weights and outputs as a `DepthCascade`, computed plainly.

    Every view is warped into a volume of its own by `grid_sample`, tensors keep their default
    layout, batch norm stays a layer, and softmax, expectation and confidence are passes of their
    own over the volume. The weights are those of the cascade it is made from, not copies.
    """

    def __init__(self, cascade: DepthCascade):
        super().__init__()
        self.regularizers = nn.ModuleList(
            TextbookRegularizer(regularizer) for regularizer in cascade.regularizers
        )
        self.hypotheses = cascade.hypotheses
        self.first_scores = cascade.first_scores

    def forward(
        self,
        pyramid: Sequence[Float[Tensor, "batch view _channel _h _w"]],
        views: Views,
        weigh: Weighing | None = None,
    ) -> list[DepthStage]:
        """One `DepthStage` for each level of the pyramid, coarse to fine."""
        stages: list[DepthStage] = []
        for index, features in enumerate(pyramid):
            height, width = features.shape[-2:]
            hypotheses = self.hypotheses(index, stages, (height, width), views).contiguous()
            intrinsics = scale_intrinsics(
                views.intrinsics, width / views.width, height / views.height
            )
            sweep = (features.contiguous(), intrinsics, views.world_from_cam, hypotheses)
            scores_of = self.first_scores if index == 0 else joint_scores
            scores = scores_of(textbook_variance_volume, self.regularizers[index], *sweep)
            if index == 0 and weigh is not None:
                scores = weigh(scores, hypotheses)
            stages.append(textbook_regress(scores, hypotheses))
        return stages


class TextbookRegularizer(nn.Module):
    """A `CostRegularizer` of PyTorch's own layers, with the same weights."""

    entry: nn.Module
    down1: nn.Module
    down2: nn.Module
    down3: nn.Module
    up2: nn.Module
    up1: nn.Module
    up0: nn.Module
    score: nn.Module
    score_filter: nn.Module

    def __init__(self, regularizer: nn.Module):
        super().__init__()
        shared = {id(x): x for x in (*regularizer.parameters(), *regularizer.buffers())}
        for name, child in copy.deepcopy(regularizer, shared).named_children():
            self.add_module(name, child)
        for layer in self.modules():
            for plain in (nn.Conv3d, nn.ConvTranspose3d):
                if isinstance(layer, plain):  # ours differ from these in `forward` alone
                    layer.__class__ = plain  # pyright: ignore[reportAttributeAccessIssue]

    def forward(
        self, volume: Float[Tensor, "batch channel plane height width"]
    ) -> Float[Tensor, "batch plane height width"]:
        """Scores before the softmax over planes."""
        level0 = self.entry(volume)
        level1 = self.down1(level0)
        level2 = self.down2(level1)
        x = level2 + self.up2(self.down3(level2))
        x = level1 + self.up1(x)
        x = level0 + self.up0(x)
        return self.score_filter(self.score(x)[:, 0])


def textbook_regress(
    scores: Float[Tensor, "batch plane height width"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> DepthStage:
    """The specification of `cascade.regress`: Eq. 3, and CasMVSNet's four-plane confidence."""
    num_planes = scores.shape[1]
    probability = torch.softmax(scores.float(), dim=1)
    depth = (probability * hypotheses).sum(dim=1)
    with torch.no_grad():
        planes = torch.arange(num_planes, device=scores.device, dtype=probability.dtype)
        expected = (probability * planes[:, None, None]).sum(dim=1).long()
        padded = F.pad(probability[:, None], (0, 0, 0, 0, 1, 2))
        mass = 4 * F.avg_pool3d(padded, (4, 1, 1), stride=1)[:, 0]
        nearest = expected.clamp(0, num_planes - 1)
        confidence = mass.gather(1, nearest[:, None])[:, 0]
    return DepthStage(hypotheses, probability, depth, confidence)
