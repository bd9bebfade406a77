"""Name -> model: the paper's sizes on one page; each "Ours" row and ablation is an assembly."""

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from inspect import signature

import torch
from timm.models.vision_transformer_sam import VisionTransformerSAM
from torch import nn
from torchvision.models import ResNet34_Weights

from mvsam.baselines.adapnet_pp import AdapNetPP
from mvsam.baselines.deeplab import DeepLabV2, DeepLabV3
from mvsam.baselines.emsaformer import EmsaFormer
from mvsam.baselines.emsaformer_decoders import EmsaNetDecoder, MlpDecoder
from mvsam.baselines.fusenet import FuseNet
from mvsam.baselines.imagenet import load_imagenet
from mvsam.baselines.mt_refinenet import MtRefineNet
from mvsam.baselines.mtan import Mtan
from mvsam.baselines.mti_net import MtiNet
from mvsam.baselines.mvs2d import MVS2D
from mvsam.baselines.pad_net import PadNet
from mvsam.baselines.segnet import SegNet
from mvsam.baselines.ssma import Ssma
from mvsam.baselines.trans_mvsnet import TransMVSNet
from mvsam.baselines.unet import UNet
from mvsam.encoders.fpn import FeaturePyramid
from mvsam.encoders.fusion import SemanticPyramid
from mvsam.encoders.sam import ConvStem, SamEncoder, sam_vit_b
from mvsam.encoders.unet import UNetPyramid, unet
from mvsam.errors import InputError
from mvsam.model import MultiViewSAM
from mvsam.mvs.cascade import DepthCascade
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.segmentation.decoder import ConvDecoder, SemanticDecoder
from mvsam.segmentation.prompts import DepthPrompt
from mvsam.segmentation.transformer import TwoWayTransformer
from mvsam.types import Model


def paper_cascade() -> DepthCascade:
    """48, 32 and 8 hypotheses at 4, 1 and 0.5 of the base interval (Sec. 4.2)."""
    return DepthCascade([CostRegularizer(channels) for channels in (32, 16, 8)])


def paper_decoder(num_classes: int) -> SemanticDecoder:
    return SemanticDecoder(num_classes, TwoWayTransformer())


def base(num_classes: int = 20, tuned_blocks: int = 3) -> MultiViewSAM:
    """Ours, full (Tables 1, 2, 4, 5): 94,220,588 parameters."""
    return MultiViewSAM(
        geometry_encoder=FeaturePyramid(),
        semantic_encoder=SamEncoder(sam_vit_b(), tuned_blocks=tuned_blocks),
        bridge=SemanticPyramid(256),
        cascade=paper_cascade(),
        prompt=DepthPrompt(),
        decoder=paper_decoder(num_classes),
    )


def base_no_bridge(num_classes: int = 20, tuned_blocks: int = 3) -> MultiViewSAM:
    """Table 5, "no SAM -> MVS": depth from geometry alone still prompts the decoder."""
    return MultiViewSAM(
        geometry_encoder=FeaturePyramid(),
        semantic_encoder=SamEncoder(sam_vit_b(), tuned_blocks=tuned_blocks),
        cascade=paper_cascade(),
        prompt=DepthPrompt(),
        decoder=paper_decoder(num_classes),
    )


def mvs_sam(num_classes: int = 20, tuned_blocks: int = 0) -> MultiViewSAM:
    """Tables 1 and 5, "MVS + SAM features": depth only, "without any encoder tuning" (Sec. 4.5)."""
    del num_classes
    return MultiViewSAM(
        geometry_encoder=FeaturePyramid(),
        semantic_encoder=SamEncoder(sam_vit_b(), tuned_blocks=tuned_blocks),
        bridge=SemanticPyramid(256),
        cascade=paper_cascade(),
    )


def cas_mvsnet(
    num_classes: int = 20, cascade: Callable[[], DepthCascade] = paper_cascade
) -> MultiViewSAM:
    """Tables 1 and 5, CasMVSNet with the paper's hypotheses and training: 934,304 parameters."""
    del num_classes
    return MultiViewSAM(geometry_encoder=FeaturePyramid(), cascade=cascade())


def mvs_unet(
    num_classes: int = 20,
    imagenet: str | None = None,
    cascade: Callable[[], DepthCascade] = paper_cascade,
) -> MultiViewSAM:
    """Table 1, "MVS + UNet features", on a ResNet-34: 25,373,216 parameters.

    The paper begins with a U-Net trained on the same split: weights of `unet_r34` find their place.
    imagenet: weights of the ResNet, see `load_imagenet`.
    """
    network = unet("resnet34", num_classes)
    released = ResNet34_Weights.IMAGENET1K_V1.get_state_dict
    weights = load_imagenet(network.encoder, imagenet, released)
    model = MultiViewSAM(geometry_encoder=UNetPyramid(FeaturePyramid(), network), cascade=cascade())
    model.backbone_weights = weights
    return model


def mvs2d(num_classes: int = 20, imagenet: str | None = None) -> MVS2D:
    """Table 1, MVS2D as released for ScanNet."""
    del num_classes
    return MVS2D(imagenet=imagenet)


def mvs2d_multiscale(num_classes: int = 20, imagenet: str | None = None) -> MVS2D:
    """MVS2D's "robust" model: epipolar attention at three scales."""
    del num_classes
    return MVS2D(attention_stages=(1, 2, 3), imagenet=imagenet)


def trans_mvsnet(num_classes: int = 20) -> TransMVSNet:
    """Table 1, TransMVSNet with the paper's hypotheses."""
    del num_classes
    return TransMVSNet()


def emsaformer(num_classes: int = 20) -> EmsaFormer:
    """Table 3, EMSAFormer with the decoder of EMSANet."""
    return EmsaFormer(num_classes, EmsaNetDecoder(num_classes))


def emsaformer_mlp(num_classes: int = 20) -> EmsaFormer:
    """EMSAFormer with the light decoder of SegFormer."""
    return EmsaFormer(num_classes, MlpDecoder(num_classes))


def sam_semantic(num_classes: int = 20, tuned_blocks: int = 0) -> MultiViewSAM:
    """Tables 4 and 5, "Semantic SAM": the decoder without depth."""
    return MultiViewSAM(
        semantic_encoder=SamEncoder(sam_vit_b(), tuned_blocks=tuned_blocks),
        decoder=paper_decoder(num_classes),
    )


def sam_semantic_gt_depth(num_classes: int = 20, tuned_blocks: int = 0) -> MultiViewSAM:
    """Table 4, RGB-D rows: the prompt is the measured depth, `views.measured_depth`."""
    return MultiViewSAM(
        semantic_encoder=SamEncoder(sam_vit_b(), tuned_blocks=tuned_blocks),
        prompt=DepthPrompt(),
        decoder=paper_decoder(num_classes),
    )


def sam_conv(num_classes: int = 20, tuned_blocks: int = 0) -> MultiViewSAM:
    """Table 4, "conv decoder": SAM features straight into an upscaling network."""
    return MultiViewSAM(
        semantic_encoder=SamEncoder(sam_vit_b(), tuned_blocks=tuned_blocks),
        decoder=ConvDecoder(num_classes),
    )


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


def tiny_encoder(tuned_blocks: int | None) -> SamEncoder:
    """`tiny_vit` as SAM's place-holder; None: all of it learns, at the rate of the other parts."""
    return SamEncoder(tiny_vit(), input_side=TINY_SIDE, tuned_blocks=tuned_blocks)


def tiny_cascade() -> DepthCascade:
    """Half the planes in the second sweep, at twice the distance: its window stays +-41 cm."""
    return DepthCascade(
        [CostRegularizer(channels) for channels in (32, 16, 8)],
        num_planes=(48, 16, 8),
        interval_ratios=(4.0, 2.0, 0.5),
    )


def tiny_semantic_gt_depth(num_classes: int = 20, tuned_blocks: int | None = None) -> MultiViewSAM:
    """The semantic half of `tiny`, prompted with measured depth.

    Trained on single pictures it stands in for SAM's pre-training, which `tiny` has none of.
    """
    return MultiViewSAM(
        semantic_encoder=tiny_encoder(tuned_blocks),
        prompt=DepthPrompt(TINY_CHANNELS),
        decoder=tiny_decoder(num_classes),
    )


def tiny(
    num_classes: int = 20, has_bridge: bool = True, tuned_blocks: int | None = None
) -> MultiViewSAM:
    """The paper's network at a size for two CPU cores; every box of Figure 3 is there."""
    return MultiViewSAM(
        geometry_encoder=FeaturePyramid(),
        semantic_encoder=tiny_encoder(tuned_blocks),
        bridge=SemanticPyramid(TINY_CHANNELS, width=16) if has_bridge else None,
        cascade=tiny_cascade(),
        prompt=DepthPrompt(TINY_CHANNELS),
        decoder=tiny_decoder(num_classes),
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


@dataclass(frozen=True)
class ModelSpec:
    """What a name stands for."""

    name: str
    build: Callable[..., Model]
    """Takes `num_classes`; the rows with SAM also `tuned_blocks`, others `imagenet`."""
    paper_row: str
    inputs: str
    tasks: tuple[str, ...]
    input_size: tuple[int, int] = (320, 256)
    """(width, height) the model works at, pixels."""


_BOTH, _DEPTH, _SEMANTICS = ("depth", "semantics"), ("depth",), ("semantics",)
_RGBD = "one RGB view and measured depth"
_ASSEMBLIES = (
    ModelSpec("base", base, "Tables 1-5: Ours, full", "posed RGB views", _BOTH),
    ModelSpec("base_no_bridge", base_no_bridge, "Table 5: no SAM->MVS", "posed RGB views", _BOTH),
    ModelSpec("mvs_sam", mvs_sam, "Tables 1, 5: MVS + SAM features", "posed RGB views", _DEPTH),
    ModelSpec("mvs_unet", mvs_unet, "Table 1: MVS + UNet features", "posed RGB views", _DEPTH),
    ModelSpec("cas_mvsnet", cas_mvsnet, "Tables 1, 5: CasMVSNet", "posed RGB views", _DEPTH),
    ModelSpec(
        "sam_semantic", sam_semantic, "Tables 4, 5: Semantic SAM", "one RGB view", _SEMANTICS
    ),
    ModelSpec(
        "sam_semantic_gt_depth",
        sam_semantic_gt_depth,
        "Table 4: Semantic SAM + GT depth",
        "one RGB view and measured depth",
        _SEMANTICS,
    ),
    ModelSpec("sam_conv", sam_conv, "Table 4: SAM, conv decoder", "one RGB view", _SEMANTICS),
    ModelSpec("tiny", tiny, "none: ours, full, for two CPU cores", "posed RGB views", _BOTH),
    ModelSpec(
        "tiny_semantic_gt_depth",
        tiny_semantic_gt_depth,
        "none: semantic half of tiny",
        "one RGB view and measured depth",
        _SEMANTICS,
    ),
    ModelSpec(
        "tiny_no_bridge",
        partial(tiny, has_bridge=False),
        "none: tiny without SAM->MVS",
        "posed RGB views",
        _BOTH,
    ),
    ModelSpec(
        "tiny_cas_mvsnet",
        partial(cas_mvsnet, cascade=tiny_cascade),
        "none: cas_mvsnet, cascade of tiny",
        "posed RGB views",
        _DEPTH,
    ),
    ModelSpec(
        "tiny_mvs_unet",
        partial(mvs_unet, cascade=tiny_cascade),
        "none: mvs_unet, cascade of tiny",
        "posed RGB views",
        _DEPTH,
    ),
    ModelSpec(
        "tiny_mvs_sam", tiny_mvs_sam, "none: tiny without decoder", "posed RGB views", _DEPTH
    ),
    ModelSpec(
        "tiny_sam_semantic",
        tiny_sam_semantic,
        "none: semantic half of tiny, no depth",
        "one RGB view",
        _SEMANTICS,
    ),
    ModelSpec(
        "tiny_sam_conv",
        tiny_sam_conv,
        "none: tiny_sam_semantic, conv decoder",
        "one RGB view",
        _SEMANTICS,
    ),
)
_BASELINES = (
    ModelSpec("trans_mvsnet", trans_mvsnet, "Table 1: TransMVSNet", "posed RGB views", _DEPTH),
    ModelSpec("mvs2d", mvs2d, "Table 1: MVS2D", "posed RGB views", _DEPTH),
    ModelSpec(
        "mvs2d_multiscale", mvs2d_multiscale, "none: MVS2D, multi-scale", "posed RGB views", _DEPTH
    ),
    ModelSpec("mt_refinenet", MtRefineNet, "Table 2: MT-RefineNet", "one RGB view", _BOTH),
    ModelSpec("pad_net", PadNet, "Table 2: PAD-Net", "one RGB view", _BOTH),
    ModelSpec("mti_net", MtiNet, "Table 2: MTI-Net", "one RGB view", _BOTH),
    ModelSpec("mtan", Mtan, "Table 2: MTAN", "one RGB view", _BOTH),
    ModelSpec("segnet", SegNet, "Table 3: SegNet", "one RGB view", _SEMANTICS),
    ModelSpec("deeplab_v2", DeepLabV2, "Table 3: DeepLab v2", "one RGB view", _SEMANTICS),
    ModelSpec("deeplab_v3", DeepLabV3, "Table 3: DeepLab v3", "one RGB view", _SEMANTICS),
    ModelSpec("adapnet_pp", AdapNetPP, "Table 3: AdapNet++", "one RGB view", _SEMANTICS),
    ModelSpec("fusenet", FuseNet, "Table 3: FuseNet", _RGBD, _SEMANTICS),
    ModelSpec("emsaformer", emsaformer, "Table 3: EMSAFormer", _RGBD, _SEMANTICS),
    ModelSpec(
        "emsaformer_mlp", emsaformer_mlp, "none: EMSAFormer, light decoder", _RGBD, _SEMANTICS
    ),
    ModelSpec("ssma", Ssma, "Table 3: SSMA", _RGBD, _SEMANTICS),
    ModelSpec(
        "unet_r34",
        partial(UNet, "resnet34"),
        "Table 4: U-Net, ResNet-34",
        "one RGB view",
        _SEMANTICS,
    ),
    ModelSpec(
        "unet_r50",
        partial(UNet, "resnet50"),
        "Table 4: U-Net, ResNet-50",
        "one RGB view",
        _SEMANTICS,
    ),
)
ASSEMBLIES = {spec.name: spec for spec in _ASSEMBLIES}
"""Put together from the parts of Figure 3: a `MultiViewSAM` each."""
MODELS = ASSEMBLIES | {spec.name: spec for spec in _BASELINES}


def model_spec(name: str) -> ModelSpec:
    """The entry of that name; InputError lists the names if there is none."""
    if name in MODELS:
        return MODELS[name]
    close = get_close_matches(name, MODELS, n=1)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    raise InputError(f"unknown model '{name}'.{hint} Models: {', '.join(MODELS)}.")


def build(name: str, num_classes: int = 20, **options) -> Model:
    """The model of that name with random weights; `options` are those of its function here."""
    spec = model_spec(name)
    known = signature(spec.build).parameters
    if unknown := sorted(set(options) - set(known)):
        raise InputError(f"model '{name}' has no option {', '.join(unknown)}.")
    return spec.build(num_classes=num_classes, **options)


def count_parameters(name: str) -> int:
    """Every `nn.Parameter`, frozen or not, at K = 20, but `auxiliary_heads`; none is allocated."""
    with torch.device("meta"):
        model = build(name)
    return sum(p.numel() for name, p in model.named_parameters() if "auxiliary_heads." not in name)
