"""An experiment: small dataclasses, each defined beside the code it configures."""

import json
import subprocess
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path

import torch

from mvsam.data.stream import DataConfig
from mvsam.training.losses import LossConfig
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
    init: tuple[str, ...] = ()
    """Weights to begin with: names, files or hub ids, later ones over earlier ones; what none of
    them has in its shape begins anew."""
    sam_checkpoint: str | None = None
    """SAM's released `sam_vit_b_*.pth` for the encoder of the paper's rows."""
    sam_decoder: bool = False
    """Take SAM's two-way transformer and upscaling from there too (the paper: the encoder only)."""


@dataclass(frozen=True)
class Experiment:
    """Everything needed to repeat a run."""

    name: str
    about: str
    """What the run is for, how long it took on which machine, and what it gave."""
    model: ModelConfig = field(default_factory=ModelConfig)
    data: DataConfig = field(default_factory=DataConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    optimizer: OptimizerConfig = field(default_factory=OptimizerConfig)
    train: TrainConfig = field(default_factory=TrainConfig)

    def save(self, path: Path) -> None:
        """As JSON, with the commit and the versions it ran under."""
        record = {**asdict(self), "commit": commit(), "versions": versions()}
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(record, indent=2) + "\n")


def commit() -> str:
    """The checkout's commit, with a + if it was changed since; "unknown" outside a checkout."""
    here = Path(__file__).parent
    try:
        name = subprocess.run(
            ["git", "rev-parse", "--short=10", "HEAD"],
            cwd=here,
            check=True,
            capture_output=True,
            text=True,
        ).stdout.strip()
        changed = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", "."], cwd=here).returncode
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return name + ("+" if changed else "")


def versions() -> dict[str, str]:
    return {name: version(name) for name in ("mvsam", "torch", "timm", "lightning", "numpy")} | {
        "device": torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu"
    }
