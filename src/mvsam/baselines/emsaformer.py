"""EMSAFormer (Fischedick et al., IJCNN 2023), its semantic task: one SwinV2 for RGB and depth.

`assemblies/published.py` puts two models together: 70,758,680 parameters with EMSANet's decoder,
52,552,924 with SegFormer's of 1x1 convolutions (`emsaformer_decoders.py`).
"""

from dataclasses import dataclass
from functools import partial

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torchvision.models.swin_transformer import (
    PatchMergingV2,
    SwinTransformer,
    SwinTransformerBlockV2,
)

from mvsam.baselines.imagenet import reference_image
from mvsam.baselines.measured import measured_depth
from mvsam.loss_terms import cross_entropy
from mvsam.types import Model, Prediction, Targets, Views


class EmsaFormer(Model):
    """Semantics of view 0 from its picture and its measured depth; trained by `EmsaFormerLoss`.

    Two pictures or more at a time: a global mean is normalised over the batch. The publication
    begins with RGB-D ImageNet weights of its own, which are not to be had here.
    depth_statistics: mean and deviation of the depths, metres. The publication measures them on
    its data; these are round numbers for rooms. Unknown depth counts as the mean.
    """

    reads_depth = True

    def __init__(
        self, num_classes: int, decoder: nn.Module, depth_statistics: tuple[float, float] = (2, 1)
    ):
        """`decoder`: takes the context and the skips, see `EmsaNetDecoder`."""
        super().__init__()
        self.num_classes = num_classes
        self.depth_statistics = depth_statistics
        self.encoder = Encoder()
        self.context = PyramidPooling(1024)
        self.decoder = decoder

    def forward(self, views: Views) -> Prediction:
        """Logits at the picture's size; sides must be divisible by 32."""
        depth, (mean, deviation) = measured_depth(views), self.depth_statistics
        scaled = ((depth - mean) / deviation).where(depth > 0, 0)
        *skips, features = self.encoder(reference_image(views, divisor=32), scaled)
        return self.decoder(self.context(features.movedim(-1, 1)), skips)


class SplitPatches(nn.Module):
    """4x4 patches as tokens of 128 values: 96 of the picture, 32 of the depth."""

    def __init__(self):
        super().__init__()
        self.patches = nn.ModuleList([nn.Conv2d(3, 96, 4, 4), nn.Conv2d(1, 32, 4, 4)])
        self.norms = nn.ModuleList([nn.LayerNorm(96), nn.LayerNorm(32)])

    def forward(
        self,
        image: Float[Tensor, "batch 3 height width"],
        depth: Float[Tensor, "batch 1 height width"],
    ) -> Float[Tensor, "batch h4 w4 128"]:
        parts = zip(self.patches, self.norms, (image, depth), strict=True)
        return torch.cat([norm(patch(x).movedim(1, -1)) for patch, norm, x in parts], dim=-1)


class Encoder(nn.Module):
    """SwinV2-T of 128 channels and windows of 8: 48,959,288 parameters, random to begin with."""

    def __init__(self):
        super().__init__()
        network = SwinTransformer(
            patch_size=[4, 4],
            embed_dim=128,
            depths=[2, 2, 6, 2],
            num_heads=[4, 8, 16, 32],
            window_size=[8, 8],
            stochastic_depth_prob=0.2,
            block=SwinTransformerBlockV2,
            norm_layer=partial(nn.LayerNorm, eps=1e-5),
            downsample_layer=PatchMergingV2,
        )
        _, *layers = network.features
        self.patches = SplitPatches()
        self.stages = nn.ModuleList(layers[0::2])
        self.merge = nn.ModuleList(layers[1::2])
        self.norm = network.norm

    def forward(
        self,
        image: Float[Tensor, "batch 3 height width"],
        depth: Float[Tensor, "batch 1 height width"],
    ) -> list[Float[Tensor, "batch _height _width _channel"]]:
        """128, 256, 512 and 1024 channels at 1/4, 1/8, 1/16 and 1/32, channels last."""
        x, outputs = self.patches(image, depth), []
        for merge, stage in zip([nn.Identity(), *self.merge], self.stages, strict=True):
            x = stage(merge(x))
            outputs.append(x)
        return [*outputs[:-1], self.norm(x)]


class PyramidPooling(nn.Module):
    """Means over 1, 4, 9 and 36 parts of the picture, mixed with what they are of."""

    def __init__(self, channels: int):
        super().__init__()
        share = channels // 4
        self.means = nn.ModuleList(
            nn.Sequential(nn.AdaptiveAvgPool2d(parts), *_block(channels, share))
            for parts in (1, 2, 3, 6)
        )
        self.mix = nn.Sequential(*_block(2 * channels, channels))

    def forward(
        self, x: Float[Tensor, "batch channel height width"]
    ) -> Float[Tensor, "batch channel height width"]:
        size = x.shape[-2:]
        means = [
            F.interpolate(mean(x), size, mode="bilinear", align_corners=False)
            for mean in self.means
        ]
        return self.mix(torch.cat([x, *means], dim=1))


def _block(in_channels: int, out_channels: int) -> list[nn.Module]:
    layer = nn.Conv2d(in_channels, out_channels, 1, bias=False)
    return [layer, nn.BatchNorm2d(out_channels), nn.ReLU()]


@dataclass(frozen=True)
class EmsaFormerLoss:
    """Cross entropy of the logits and of every side output at its own scale, all alike."""

    class_weights: tuple[float, ...] | None = None
    """The release weights classes by median frequency; none: all alike."""

    def __call__(
        self, prediction: Prediction, targets: Targets, depth_range: Float[Tensor, "batch 2"]
    ) -> dict[str, Float[Tensor, ""]]:
        """`loss` and its parts `segmentation` and `auxiliary`; labels shrink to the nearest."""
        parts = [
            self._cross_entropy(output, targets) for output in (prediction, *prediction.auxiliary)
        ]
        total = torch.stack(parts).sum()
        return {"loss": total, "segmentation": parts[0], "auxiliary": total - parts[0]}

    def _cross_entropy(self, output: Prediction, targets: Targets) -> Tensor:
        assert output.logits is not None
        labels = targets.labels[:, None].float()
        labels = F.interpolate(labels, output.logits.shape[-2:], mode="nearest-exact")[:, 0]
        return cross_entropy(output.logits, labels.long(), self.class_weights)
