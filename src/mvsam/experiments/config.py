"""An experiment: small dataclasses, each defined beside the code it configures."""

import json
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from mvsam.data.labels import ClassTable
from mvsam.data.streaming.config import DataConfig
from mvsam.files import write_json
from mvsam.loss_terms import Loss
from mvsam.provenance import provenance
from mvsam.training.losses import JointLoss
from mvsam.training.module import TrainConfig
from mvsam.training.optim import OptimizerConfig


@dataclass(frozen=True)
class ModelConfig:
    """Which model a run trains."""

    name: str = "tiny"
    """One of `mvsam models`."""
    num_classes: int | None = None
    """The paper's K; none: as many as the training data have classes."""
    tuned_blocks: int | None = None
    """For the rows with SAM ViT-B: how many of its last blocks learn; none: the row's own."""
    imagenet: str | None = None
    """For the other methods: ImageNet weights of the backbone, a file or `download`; none: random.
    """
    init: tuple[str, ...] = ()
    """Weights to begin with: names, files or hub ids, later ones over earlier ones; what none of
    them has in its shape begins anew."""
    semantic_encoder: str | None = None
    """Weights of which the semantic encoder alone is taken, in place of SAM's pre-training."""
    sam_checkpoint: str | None = None
    """SAM's released `sam_vit_b_*.pth` for the encoder of the paper's rows."""
    sam_decoder: bool = False
    """Take SAM's two-way transformer and upscaling from there too (the paper: the encoder only)."""
    feature_cache: str | None = None
    """Folder for what the frozen part of SAM's encoder says about each picture, computed once: 6.3
    MB a picture for ViT-B, 2.1 MB where none of its blocks learns. For pictures that are shown
    unchanged every time; none: compute anew every time."""

    @property
    def beginnings(self) -> tuple[str, ...]:
        """Weights that it begins with, of the encoder first: names, files and hub ids."""
        given = (self.semantic_encoder, self.sam_checkpoint, *self.init)
        return tuple(path for path in given if path)

    def without_files(self) -> "ModelConfig":
        """The same model, to be given weights that hold all of it; ImageNet's stay asked for."""
        return replace(self, init=(), semantic_encoder=None, sam_checkpoint=None)


@dataclass(frozen=True)
class Experiment:
    """Everything needed to repeat a run."""

    name: str
    about: str
    """What the run is for, and about how long it takes on which machine."""
    model: ModelConfig = field(default_factory=ModelConfig)
    data: DataConfig = field(default_factory=DataConfig)
    loss: Loss = field(default_factory=JointLoss)
    optimizer: OptimizerConfig = field(default_factory=OptimizerConfig)
    train: TrainConfig = field(default_factory=TrainConfig)

    def as_json(self) -> dict:
        """What JSON makes of it: tuples become lists."""
        return json.loads(json.dumps(record_of(self)))

    def save(self, path: Path, classes: ClassTable, began_with: str, device: str) -> None:
        """As JSON, with classes, first weights, the command, commit, device and versions."""
        names = {"classes": classes.names, "palette": classes.colors}
        record = {**record_of(self), **names, "began_with": began_with, **provenance(device)}
        write_json(path, record)


def record_of(settings: Any) -> Any:
    """A dataclass as a dict; parts that are called, as losses, also say which they are."""
    if not is_dataclass(settings):
        return settings
    named = {f.name: record_of(getattr(settings, f.name)) for f in fields(settings)}
    return {"part": type(settings).__name__, **named} if callable(settings) else named
