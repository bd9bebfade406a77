"""The paper's "Ours" rows and ablations, each an assembly of the boxes of Figure 3 at its sizes."""

from collections.abc import Callable

from torchvision.models import ResNet34_Weights

from mvsam.baselines.imagenet import load_imagenet
from mvsam.encoders.fpn import FeaturePyramid
from mvsam.encoders.fusion import SemanticPyramid
from mvsam.encoders.sam import SamEncoder, sam_vit_b
from mvsam.encoders.unet import UNetPyramid, unet
from mvsam.model import MultiViewSAM
from mvsam.mvs.cascade import DepthCascade
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.segmentation.decoder import ConvDecoder, SemanticDecoder
from mvsam.segmentation.prompts import DepthPrompt
from mvsam.segmentation.transformer import TwoWayTransformer


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
    """Tables 1 and 5, CasMVSNet with the paper's hypotheses and training: 934,304 parameters.

    Windows of hypotheses stay in the depth range as ours do; CasMVSNet's code lets them leave it
    (`DepthCascade(clamp="none")`).
    """
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
