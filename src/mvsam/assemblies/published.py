"""Methods of other publications whose classes are handed a part or a setting for a row.

The rest of `baselines/` is built as it stands, from a number of classes.
"""

from mvsam.baselines.emsaformer import EmsaFormer
from mvsam.baselines.emsaformer_decoders import EmsaNetDecoder, MlpDecoder
from mvsam.baselines.mvs2d import MVS2D
from mvsam.baselines.trans_mvsnet import TransMVSNet


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
