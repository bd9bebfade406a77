"""The semantic encoder of Figure 3: a SAM image encoder, its input recipe and its output grid."""

from functools import partial
from itertools import pairwise
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from timm.models.vision_transformer_sam import VisionTransformerSAM
from torch import Tensor, nn

from mvsam.encoders.attention import RelativeAttention
from mvsam.encoders.feature_cache import FeatureCache, hash_of_weights
from mvsam.errors import InputError

IMAGE_MEAN = (123.675 / 255, 116.28 / 255, 103.53 / 255)
IMAGE_STD = (58.395 / 255, 57.12 / 255, 57.375 / 255)


def sam_vit_b() -> VisionTransformerSAM:
    """SAM's ViT-B image encoder, 89,670,912 parameters, weights as yet random.

    timm's class with LayerNorm eps 1e-6: SAM's value, where timm's default is 1e-5.
    """
    return VisionTransformerSAM(
        img_size=1024,
        patch_size=16,
        embed_dim=768,
        depth=12,
        num_heads=12,
        num_classes=0,
        use_rel_pos=True,
        window_size=14,
        global_attn_indexes=(2, 5, 8, 11),
        neck_chans=256,
        norm_layer=partial(nn.LayerNorm, eps=1e-6),  # pyright: ignore[reportArgumentType]
    )


class SamEncoder(nn.Module):
    """SAM features of a picture, resampled once to a quarter of its size (Sec. 3.1).

    The paper resizes SAM's tokens "to the coarsest MVS resolution" and later upscales twice "to
    match W x H". Both hold exactly when the valid part of the token grid is resampled to
    H/4 x W/4 once and that grid serves the bridge and the decoder alike.

    backbone: picture, RGB normalised and padded to a square -> channel x side/patch x side/patch.
    input_side: longer side of the picture for SAM, pixels (SAM: 1024).
    patch_size: pixels a token (SAM: 16).
    tuned_blocks: how many of the last blocks learn, with the neck (the paper: 0 to 3); None: all.

    Raises InputError for more tuned blocks than there are, or fewer than none.
    """

    feature_cache: FeatureCache | None = None
    """Keeps the frozen part's features on disk (`cache_frozen_part`); None: computed every time."""

    def __init__(
        self,
        backbone: VisionTransformerSAM,
        input_side: int = 1024,
        patch_size: int = 16,
        tuned_blocks: int | None = 0,
    ):
        super().__init__()
        num_blocks = len(backbone.blocks)
        if tuned_blocks is not None and not 0 <= tuned_blocks <= num_blocks:
            raise InputError(
                f"{tuned_blocks} tuned blocks of an encoder that has {num_blocks}: give 0 to "
                f"{num_blocks}."
            )
        self.backbone = backbone
        self.input_side = input_side
        self.patch_size = patch_size
        self.channels = backbone.num_features
        self.tuned_blocks = tuned_blocks
        self.register_buffer("mean", torch.tensor(IMAGE_MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(IMAGE_STD).view(3, 1, 1), persistent=False)
        self.mean: Tensor
        self.std: Tensor
        for block in backbone.blocks:
            block.attn = RelativeAttention(block.attn)  # pyright: ignore
        if tuned_blocks is not None:
            self._freeze(tuned_blocks)

    def _freeze(self, tuned_blocks: int) -> None:
        self.backbone.requires_grad_(False)
        if tuned_blocks:
            self.backbone.blocks[-tuned_blocks:].requires_grad_(True)
            self.backbone.neck.requires_grad_(True)

    def train(self, mode: bool = True) -> "SamEncoder":
        """What is frozen stays in evaluation mode: the batch norms of a `ConvStem` would move."""
        super().train(mode)
        if self.tuned_blocks is not None:
            self.backbone.patch_embed.eval()
        return self

    def forward(
        self, images: Float[Tensor, "images 3 height width"], size: tuple[int, int] | None = None
    ) -> Float[Tensor, "images channel feature_height feature_width"]:
        """RGB in [0, 1] in, features out.

        size: (height, width) of the features; None: a quarter of the images'. The paper leaves open
        whether SAM sees the network's own pictures, which we chose, or the photos they were made
        from: those may have any size, while the features still have to fit the former.
        """
        height, width = images.shape[-2:]
        inner_height, inner_width = self.inner_size(height, width)
        tokens = self.tokens(images)
        valid = inner_height / self.patch_size, inner_width / self.patch_size
        return resample_valid(tokens, valid, size or (height // 4, width // 4))

    def inner_size(self, height: int, width: int) -> tuple[int, int]:
        """(height, width) at which SAM sees the picture: the longer side is `input_side`."""
        scale = self.input_side / max(height, width)
        return int(height * scale + 0.5), int(width * scale + 0.5)

    def prepare(
        self, images: Float[Tensor, "images 3 height width"]
    ) -> Float[Tensor, "images 3 side side"]:
        """SAM's recipe: resize, normalise, then pad right and bottom with zeros."""
        inner = self.inner_size(images.shape[-2], images.shape[-1])
        if inner != tuple(images.shape[-2:]):
            images = F.interpolate(
                images, inner, mode="bilinear", align_corners=False, antialias=True
            )
        images = (images - self.mean) / self.std
        return F.pad(images, (0, self.input_side - inner[1], 0, self.input_side - inner[0]))

    def tokens(
        self, images: Float[Tensor, "images 3 height width"]
    ) -> Float[Tensor, "images channel rows columns"]:
        """The backbone's output; its frozen part runs without gradient, or is read from disk."""
        if self.tuned_blocks is None:
            return self.backbone.forward_features(self.prepare(images))
        cache = self.feature_cache
        x = self.frozen_part(images) if cache is None else cache(images, self.frozen_part)
        if not self.tuned_blocks:
            return x
        x = self.backbone.blocks[-self.tuned_blocks :](x)
        return self.backbone.neck(x.permute(0, 3, 1, 2))

    @torch.no_grad()
    def frozen_part(
        self, images: Float[Tensor, "images 3 height width"]
    ) -> Float[Tensor, "images *features"]:
        """What no training changes: the tokens (rows, columns, channel) before the first tuned
        block, or the backbone's output where no block is tuned."""
        if not self.tuned_blocks:
            return self.backbone.forward_features(self.prepare(images))
        x = self.backbone.patch_embed(self.prepare(images)) + self.backbone.pos_embed
        return self.backbone.blocks[: -self.tuned_blocks](x)

    def cache_frozen_part(self, folder: Path) -> FeatureCache:
        """Keeps the frozen part's features in `folder` from now on.

        Its weights must not change any more once the first picture was seen.

        Raises `InputError` where nothing is frozen.
        """
        if self.tuned_blocks is None:
            raise InputError(
                "all of this model's encoder learns: there are no frozen features to keep; leave "
                "the feature cache out."
            )
        backbone, tuned = self.backbone, self.tuned_blocks
        frozen: list[nn.Module | Tensor] = [backbone]
        if tuned:
            assert backbone.pos_embed is not None
            frozen = [backbone.patch_embed, backbone.pos_embed, backbone.blocks[:-tuned]]
        side = self.input_side
        self.feature_cache = FeatureCache(folder, lambda: f"{hash_of_weights(frozen)} {side}")
        return self.feature_cache


def cache_frozen_features(model: nn.Module, folder: Path) -> FeatureCache:
    """`SamEncoder.cache_frozen_part` of a model; InputError where it has no such encoder."""
    encoder = getattr(model, "semantic_encoder", None)
    if not isinstance(encoder, SamEncoder):
        raise InputError("this model has no SAM encoder: leave the feature cache out.")
    return encoder.cache_frozen_part(folder)


def resample_valid(
    tokens: Float[Tensor, "images channel rows columns"],
    valid: tuple[float, float],
    size: tuple[int, int],
) -> Float[Tensor, "images channel height width"]:
    """The top left `valid` (rows, columns) of the token grid, bilinearly resampled to `size`.

    `valid` may be fractional (51.1875 rows for 320 x 256 in SAM's 1024): one sampling, so that no
    rounding comes between the picture and its features. Reads stay inside the valid extent.
    """
    rows, columns = tokens.shape[-2:]
    y = (torch.arange(size[0], device=tokens.device) + 0.5) * (valid[0] / size[0])
    x = (torch.arange(size[1], device=tokens.device) + 0.5) * (valid[1] / size[1])
    y = y.clamp(0.5, max(valid[0] - 0.5, 0.5)) * (2 / rows) - 1
    x = x.clamp(0.5, max(valid[1] - 0.5, 0.5)) * (2 / columns) - 1
    grid = torch.stack(torch.meshgrid(y, x, indexing="ij")[::-1], dim=-1)
    grid = grid.expand(tokens.shape[0], -1, -1, -1)  # not len(): it would fix the count at export
    # In float32: bfloat16 would round the positions by up to a third of a pixel.
    sampled = F.grid_sample(
        tokens.float(), grid, mode="bilinear", padding_mode="border", align_corners=False
    )
    return sampled.to(tokens.dtype)


class ConvStem(nn.Module):
    """Patch embedding by four 3x3 convolutions of stride 2, for a ViT trained from scratch.

    Early convolutions let a small transformer learn from few pictures (Xiao et al., "Early
    Convolutions Help Transformers See Better", 2021). Only for a patch size of 16.
    """

    def __init__(self, img_size: int, patch_size: int, in_chans: int, embed_dim: int, **_: object):
        super().__init__()
        if patch_size != 16:
            raise ValueError(f"ConvStem divides the image by 16, not by {patch_size}")
        self.grid_size = (img_size // 16, img_size // 16)
        widths = (in_chans, embed_dim // 8, embed_dim // 4, embed_dim // 2, embed_dim)
        blocks: list[nn.Module] = []
        for narrow, wide in pairwise(widths):
            blocks += [
                nn.Conv2d(narrow, wide, 3, 2, 1, bias=False),
                nn.BatchNorm2d(wide),
                nn.ReLU(),
            ]
        self.layers = nn.Sequential(*blocks, nn.Conv2d(embed_dim, embed_dim, 1))

    def forward(
        self, images: Float[Tensor, "images 3 height width"]
    ) -> Float[Tensor, "images rows columns channel"]:
        """Tokens in timm's channels-last order."""
        return self.layers(images).permute(0, 2, 3, 1)
