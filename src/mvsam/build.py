"""Name -> model: what every name stands for, which row of the paper it is, and how to build it."""

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from functools import partial
from inspect import signature

import torch

from mvsam.assemblies.paper import (
    base,
    base_no_bridge,
    cas_mvsnet,
    mvs_sam,
    mvs_unet,
    sam_conv,
    sam_semantic,
    sam_semantic_gt_depth,
)
from mvsam.assemblies.published import (
    emsaformer,
    emsaformer_mlp,
    mvs2d,
    mvs2d_multiscale,
    trans_mvsnet,
)
from mvsam.assemblies.tiny import (
    tiny,
    tiny_base,
    tiny_cascade,
    tiny_mvs_sam,
    tiny_sam_conv,
    tiny_sam_semantic,
    tiny_semantic,
    tiny_semantic_gt_depth,
)
from mvsam.baselines.adapnet_pp import AdapNetPP
from mvsam.baselines.deeplab import DeepLabV2, DeepLabV3
from mvsam.baselines.fusenet import FuseNet
from mvsam.baselines.mt_refinenet import MtRefineNet
from mvsam.baselines.mtan import Mtan
from mvsam.baselines.mti_net import MtiNet
from mvsam.baselines.pad_net import PadNet
from mvsam.baselines.segnet import SegNet
from mvsam.baselines.ssma import Ssma
from mvsam.baselines.unet import UNet
from mvsam.errors import InputError
from mvsam.types import Model


class Inputs(StrEnum):
    """What a model looks at."""

    VIEWS = "posed RGB views"
    PICTURE = "one RGB view"
    RGBD = "one RGB view and measured depth"


@dataclass(frozen=True)
class ModelSpec:
    """What a name stands for."""

    name: str
    build: Callable[..., Model]
    """Takes `num_classes`; the rows with SAM also `tuned_blocks`, others `imagenet`."""
    paper_row: str
    inputs: Inputs
    tasks: tuple[str, ...]
    input_size: tuple[int, int] = (320, 256)
    """(width, height) the model works at, pixels."""

    @property
    def fewest_views(self) -> int:
        """Photos that it needs at least: one if it looks at single pictures, else two."""
        return 2 if self.inputs is Inputs.VIEWS else 1


_VIEWS, _PICTURE, _RGBD = Inputs.VIEWS, Inputs.PICTURE, Inputs.RGBD
_BOTH, _DEPTH, _LABELS = ("depth", "semantics"), ("depth",), ("semantics",)
_ASSEMBLIES = (
    ModelSpec("base", base, "Tables 1-5: Ours, full", _VIEWS, _BOTH),
    ModelSpec("base_no_bridge", base_no_bridge, "Table 5: no SAM->MVS", _VIEWS, _BOTH),
    ModelSpec("mvs_sam", mvs_sam, "Tables 1, 5: MVS + SAM features", _VIEWS, _DEPTH),
    ModelSpec("mvs_unet", mvs_unet, "Table 1: MVS + UNet features", _VIEWS, _DEPTH),
    ModelSpec("cas_mvsnet", cas_mvsnet, "Tables 1, 5: CasMVSNet", _VIEWS, _DEPTH),
    ModelSpec("sam_semantic", sam_semantic, "Tables 4, 5: Semantic SAM", _PICTURE, _LABELS),
    ModelSpec(
        "sam_semantic_gt_depth",
        sam_semantic_gt_depth,
        "Table 4: Semantic SAM + GT depth",
        _RGBD,
        _LABELS,
    ),
    ModelSpec("sam_conv", sam_conv, "Table 4: SAM, conv decoder", _PICTURE, _LABELS),
    ModelSpec("tiny", tiny, "none: two CPU cores; a prior and a context network", _VIEWS, _BOTH),
    ModelSpec("tiny_semantic", tiny_semantic, "none: semantic half of tiny", _RGBD, _LABELS),
    ModelSpec("tiny_base", tiny_base, "none: base in the sizes of tiny", _VIEWS, _BOTH),
    ModelSpec(
        "tiny_no_bridge",
        partial(tiny_base, has_bridge=False),
        "none: tiny_base without SAM->MVS",
        _VIEWS,
        _BOTH,
    ),
    ModelSpec(
        "tiny_cas_mvsnet",
        partial(cas_mvsnet, cascade=tiny_cascade),
        "none: cas_mvsnet, cascade of tiny",
        _VIEWS,
        _DEPTH,
    ),
    ModelSpec(
        "tiny_mvs_unet",
        partial(mvs_unet, cascade=tiny_cascade),
        "none: mvs_unet, cascade of tiny",
        _VIEWS,
        _DEPTH,
    ),
    ModelSpec("tiny_mvs_sam", tiny_mvs_sam, "none: mvs_sam, sizes of tiny", _VIEWS, _DEPTH),
    ModelSpec(
        "tiny_semantic_gt_depth",
        tiny_semantic_gt_depth,
        "none: sam_semantic_gt_depth, sizes of tiny",
        _RGBD,
        _LABELS,
    ),
    ModelSpec(
        "tiny_sam_semantic",
        tiny_sam_semantic,
        "none: sam_semantic, sizes of tiny",
        _PICTURE,
        _LABELS,
    ),
    ModelSpec(
        "tiny_sam_conv", tiny_sam_conv, "none: tiny_sam_semantic, conv decoder", _PICTURE, _LABELS
    ),
)
_BASELINES = (
    ModelSpec("trans_mvsnet", trans_mvsnet, "Table 1: TransMVSNet", _VIEWS, _DEPTH),
    ModelSpec("mvs2d", mvs2d, "Table 1: MVS2D", _VIEWS, _DEPTH),
    ModelSpec("mvs2d_multiscale", mvs2d_multiscale, "none: MVS2D, multi-scale", _VIEWS, _DEPTH),
    ModelSpec("mt_refinenet", MtRefineNet, "Table 2: MT-RefineNet", _PICTURE, _BOTH),
    ModelSpec("pad_net", PadNet, "Table 2: PAD-Net", _PICTURE, _BOTH),
    ModelSpec("mti_net", MtiNet, "Table 2: MTI-Net", _PICTURE, _BOTH),
    ModelSpec("mtan", Mtan, "Table 2: MTAN", _PICTURE, _BOTH),
    ModelSpec("segnet", SegNet, "Table 3: SegNet", _PICTURE, _LABELS),
    ModelSpec("deeplab_v2", DeepLabV2, "Table 3: DeepLab v2", _PICTURE, _LABELS),
    ModelSpec("deeplab_v3", DeepLabV3, "Table 3: DeepLab v3", _PICTURE, _LABELS),
    ModelSpec("adapnet_pp", AdapNetPP, "Table 3: AdapNet++", _PICTURE, _LABELS),
    ModelSpec("fusenet", FuseNet, "Table 3: FuseNet", _RGBD, _LABELS),
    ModelSpec("emsaformer", emsaformer, "Table 3: EMSAFormer", _RGBD, _LABELS),
    ModelSpec("emsaformer_mlp", emsaformer_mlp, "none: EMSAFormer, light decoder", _RGBD, _LABELS),
    ModelSpec("ssma", Ssma, "Table 3: SSMA", _RGBD, _LABELS),
    ModelSpec(
        "unet_r34", partial(UNet, "resnet34"), "Table 4: U-Net, ResNet-34", _PICTURE, _LABELS
    ),
    ModelSpec(
        "unet_r50", partial(UNet, "resnet50"), "Table 4: U-Net, ResNet-50", _PICTURE, _LABELS
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
    """The model of that name with random weights; `options` are those of its `ModelSpec.build`."""
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
