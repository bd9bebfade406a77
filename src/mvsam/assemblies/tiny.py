"""The paper's network and its ablations at sizes for two CPU cores."""

from functools import partial

from timm.models.vision_transformer_sam import VisionTransformerSAM
from torch import nn

from mvsam.encoders.fpn import FeaturePyramid
from mvsam.encoders.fusion import SemanticPyramid
from mvsam.encoders.sam import ConvStem, SamEncoder
from mvsam.grid_filter import GridFilter
from mvsam.model import MultiViewSAM
from mvsam.mvs.cascade import DepthCascade
from mvsam.mvs.context import ContextNetwork
from mvsam.mvs.prior import MonocularPrior
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.mvs.votes import Scoring, joint_scores, voted_scores
from mvsam.segmentation.decoder import ConvDecoder, SemanticDecoder
from mvsam.segmentation.prompts import DepthPrompt
from mvsam.segmentation.transformer import TwoWayTransformer

TINY_SIDE = 320
TINY_CHANNELS = 128


def tiny_vit() -> VisionTransformerSAM:
    """A SAM-type ViT for 320 pixels: windows of 10 x 10 tokens, every third block global.

    Its blocks begin as the identity (last layers zero), so that from the first step on the decoder
    sees the convolutional stem's features; SAM's pre-training is what would otherwise do that.
    """
    encoder = VisionTransformerSAM(
        img_size=TINY_SIDE,
        patch_size=16,
        embed_dim=192,
        depth=6,
        num_heads=3,
        num_classes=0,
        use_rel_pos=True,
        window_size=10,
        global_attn_indexes=(2, 5),
        neck_chans=TINY_CHANNELS,
        norm_layer=partial(nn.LayerNorm, eps=1e-6),  # pyright: ignore[reportArgumentType]
        embed_layer=ConvStem,
    )
    for block in encoder.blocks:
        for layer in (block.attn.proj, block.mlp.fc2):  # pyright: ignore
            nn.init.zeros_(layer.weight)  # pyright: ignore
            nn.init.zeros_(layer.bias)  # pyright: ignore
    return encoder


def tiny_decoder(num_classes: int) -> SemanticDecoder:
    transformer = TwoWayTransformer(TINY_CHANNELS, num_heads=4, mlp_channels=512)
    return SemanticDecoder(num_classes, transformer, TINY_CHANNELS)


def smooth_tiny_decoder(num_classes: int) -> SemanticDecoder:
    """`tiny_decoder` with class borders free of combs; not a part of the paper's decoder."""
    decoder = tiny_decoder(num_classes)
    decoder.upscaling.append(GridFilter())
    return decoder


def tiny_encoder(tuned_blocks: int | None) -> SamEncoder:
    """`tiny_vit` as SAM's place-holder; None: all of it learns, at the rate of the other parts."""
    return SamEncoder(tiny_vit(), input_side=TINY_SIDE, tuned_blocks=tuned_blocks)


def tiny_cascade(
    first_scores: Scoring = joint_scores, last_filter: nn.Module | None = None
) -> DepthCascade:
    """Half the planes in the second sweep, at twice the distance: its window stays +-41 cm."""
    return DepthCascade(
        [CostRegularizer(32), CostRegularizer(16), CostRegularizer(8, score_filter=last_filter)],
        num_planes=(48, 16, 8),
        interval_ratios=(4.0, 2.0, 0.5),
        first_scores=first_scores,
    )


def tiny(num_classes: int = 20, tuned_blocks: int | None = None) -> MultiViewSAM:
    """The paper's network at a size for two CPU cores, with a monocular prior on its depth.

    Each source view has a vote of its own in the first sweep, and a network that sees around each
    pixel says how far to trust that sweep; the later ones see features without blocks, and may
    match in larger pictures than those it learned from.
    """
    return tiny_base(
        num_classes,
        tuned_blocks=tuned_blocks,
        geometry_encoder=FeaturePyramid(upsampling="bilinear"),
        cascade=tiny_cascade(voted_scores, last_filter=GridFilter()),
        prior=MonocularPrior(TINY_CHANNELS),
        context=ContextNetwork(32, TINY_CHANNELS),
        decoder=smooth_tiny_decoder(num_classes),
        has_finer_sweeps=True,
    )


def tiny_semantic(num_classes: int = 20, tuned_blocks: int | None = None) -> MultiViewSAM:
    """The semantic half of `tiny`, prompted with measured depth, and its prior.

    Trained on single pictures it stands in for SAM's pre-training, which `tiny` has none of.
    """
    return tiny_semantic_gt_depth(
        num_classes,
        tuned_blocks,
        prior=MonocularPrior(TINY_CHANNELS),
        decoder=smooth_tiny_decoder(num_classes),
    )


def tiny_base(
    num_classes: int = 20,
    has_bridge: bool = True,
    tuned_blocks: int | None = None,
    geometry_encoder: FeaturePyramid | None = None,
    cascade: DepthCascade | None = None,
    prior: MonocularPrior | None = None,
    context: ContextNetwork | None = None,
    decoder: SemanticDecoder | None = None,
    has_finer_sweeps: bool = False,
) -> MultiViewSAM:
    """`base` in the sizes of `tiny`; every box of Figure 3 is there and no other."""
    return MultiViewSAM(
        geometry_encoder=geometry_encoder or FeaturePyramid(),
        semantic_encoder=tiny_encoder(tuned_blocks),
        bridge=SemanticPyramid(TINY_CHANNELS, width=16) if has_bridge else None,
        cascade=cascade or tiny_cascade(),
        prior=prior,
        context=context,
        prompt=DepthPrompt(TINY_CHANNELS),
        decoder=decoder or tiny_decoder(num_classes),
        has_finer_sweeps=has_finer_sweeps,
    )


def tiny_mvs_sam(num_classes: int = 20, tuned_blocks: int | None = None) -> MultiViewSAM:
    """`mvs_sam` in the sizes of `tiny`."""
    del num_classes
    return MultiViewSAM(
        geometry_encoder=FeaturePyramid(),
        semantic_encoder=tiny_encoder(tuned_blocks),
        bridge=SemanticPyramid(TINY_CHANNELS, width=16),
        cascade=tiny_cascade(),
    )


def tiny_semantic_gt_depth(
    num_classes: int = 20,
    tuned_blocks: int | None = None,
    prior: MonocularPrior | None = None,
    decoder: SemanticDecoder | None = None,
) -> MultiViewSAM:
    """`sam_semantic_gt_depth` in the sizes of `tiny`."""
    return MultiViewSAM(
        semantic_encoder=tiny_encoder(tuned_blocks),
        prior=prior,
        prompt=DepthPrompt(TINY_CHANNELS),
        decoder=decoder or tiny_decoder(num_classes),
    )


def tiny_sam_semantic(num_classes: int = 20, tuned_blocks: int | None = None) -> MultiViewSAM:
    """`sam_semantic` in the sizes of `tiny`."""
    return MultiViewSAM(
        semantic_encoder=tiny_encoder(tuned_blocks), decoder=tiny_decoder(num_classes)
    )


def tiny_sam_conv(num_classes: int = 20, tuned_blocks: int | None = None) -> MultiViewSAM:
    """`sam_conv` in the sizes of `tiny`."""
    return MultiViewSAM(
        semantic_encoder=tiny_encoder(tuned_blocks),
        decoder=ConvDecoder(num_classes, TINY_CHANNELS),
    )
