"""How each method of the tables is trained by its publication, whatever the data.

Sources: the papers and the settings of the released code. Input scaling is part of each model.
Augmentations are those of the publications that `DataConfig` has: mirroring, and a jitter of the
colours; random scales and crops are left out everywhere.
"""

from dataclasses import dataclass, fields, replace

from mvsam.baselines.adapnet_pp import AdapNetPPLoss
from mvsam.baselines.emsaformer import EmsaFormerLoss
from mvsam.baselines.mt_refinenet import MtRefineNetLoss
from mvsam.baselines.multi_task import MultiTaskLoss
from mvsam.baselines.mvs2d import Mvs2dLoss
from mvsam.baselines.trans_mvsnet import TransMVSNetLoss
from mvsam.loss_terms import Loss
from mvsam.training.losses import JointLoss
from mvsam.training.optim import SGD, Adam, Milestones, OneCycle, OptimizerConfig, Polynomial

_CONSTANT = Milestones(shares=(), warmup_steps=0)


@dataclass(frozen=True)
class Recipe:
    """Loss, optimiser, batch, length and augmentation."""

    loss: Loss
    optimizer: OptimizerConfig
    """Its `steps` are set by whoever knows the data."""
    batch_size: int = 8
    """Samples a step, all processes together."""
    epochs: int = 16
    """Passes over ScanNet's samples; where a publication says none, as many as the paper's own."""
    mirror: bool = False
    color_jitter: float = 0.0
    """As `DataConfig.color_jitter`; 0.1 is the spread of factors drawn from 0.8 to 1.2."""

    def with_class_weights(self, weights: tuple[float, ...]) -> "Recipe":
        """The same with weighted classes; unchanged where the method has no classes."""
        if "class_weights" not in {field.name for field in fields(self.loss)}:  # pyright: ignore
            return self
        return replace(self, loss=replace(self.loss, class_weights=weights))  # pyright: ignore


PAPER = Recipe(JointLoss(), OptimizerConfig())
"""Sec. 4.1. The paper trains CasMVSNet and TransMVSNet with these settings too."""

TRANS_MVSNET = replace(PAPER, loss=TransMVSNetLoss())
"""The paper's settings with its own loss, as it has no smooth depth that Eq. 4 could train."""

MVS2D = Recipe(
    Mvs2dLoss(),
    OptimizerConfig(
        lr=2e-4,
        weight_decay=0.0,
        gradient_clip=10.0,
        algorithm=Adam(),
        schedule=Milestones(shares=(25 / 30, 28 / 30), factor=0.1, warmup_steps=0),
    ),
    batch_size=64,
    epochs=30,
    color_jitter=0.1,
)
"""Its own settings for ScanNet (the paper: "with its own"), but for the pictures: 320x256 as all
rows, where its own are 640x480; it jitters brightness, contrast,
saturation and hue of every other picture, ours exposure, white balance, contrast and gamma of each.
"""

UNET = replace(PAPER, mirror=True, color_jitter=0.1)
"""The paper gives no settings of Table 4's U-Nets: its own, with the augmentation of pictures."""

MT_REFINENET = Recipe(
    MtRefineNetLoss(),
    OptimizerConfig(lr=1e-3, weight_decay=1e-5, algorithm=SGD(), schedule=_CONSTANT),
    batch_size=4,
    mirror=True,
)
"""The released example, which its page says are not the publication's settings."""

MULTI_TASK = Recipe(
    MultiTaskLoss(),
    OptimizerConfig(lr=1e-4, weight_decay=1e-4, algorithm=Adam(), schedule=Polynomial()),
    epochs=100,
    mirror=True,
)
"""PAD-Net, MTI-Net and MTAN as released together, with the rate lowered every step."""

SEGNET = Recipe(
    JointLoss(),
    OptimizerConfig(lr=1e-3, weight_decay=5e-4, algorithm=SGD(), schedule=_CONSTANT),
    mirror=True,
)
"""Its class weights by median frequency are left out on ScanNet; on rooms they are the budget's."""

DEEPLAB_V2 = Recipe(
    JointLoss(),
    OptimizerConfig(lr=2.5e-4, weight_decay=5e-4, algorithm=SGD(), schedule=Polynomial()),
    mirror=True,
)
"""Its 20,000 steps of another data set became the paper's own 16 epochs."""

DEEPLAB_V3 = replace(
    DEEPLAB_V2, optimizer=replace(DEEPLAB_V2.optimizer, lr=7e-3, weight_decay=1e-4)
)
"""Version 2's schedule; rate and decay from memory of the publication, not looked up."""

ADAPNET_PP = Recipe(
    AdapNetPPLoss(),
    OptimizerConfig(lr=1e-3, weight_decay=0.0, algorithm=Adam(), schedule=Polynomial()),
    mirror=True,
)
"""SSMA's too. Its published first stage, an encoder alone for each kind of input, is left out."""

FUSENET = Recipe(
    JointLoss(),
    OptimizerConfig(
        lr=5e-3,
        weight_decay=5e-4,
        algorithm=SGD(),
        schedule=Milestones(tuple(i / 12 for i in range(1, 12)), factor=0.9, warmup_steps=0),
    ),
    epochs=300,
    mirror=True,
)
"""Cut by a tenth every 25 epochs; that there are 300 of them is our choice."""

EMSAFORMER = Recipe(
    EmsaFormerLoss(),
    OptimizerConfig(lr=0.03, weight_decay=1e-4, algorithm=SGD(nesterov=True), schedule=OneCycle()),
    epochs=500,
    mirror=True,
    color_jitter=0.1,
)
"""Its class weights are left out on ScanNet; it jitters hue, saturation and value, ours as `MVS2D`.
"""
