"""The Lightning module: losses, optimiser and what is logged, for any `model(views)`."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from lightning import LightningModule
from torch import Tensor, nn

from mvsam.evaluation.evaluate import SceneScores, score_item
from mvsam.evaluation.protocols import Protocol
from mvsam.loss_terms import Loss
from mvsam.training.optim import OptimizerConfig, make_optimizer
from mvsam.types import EncodesViews, Prediction, Targets, Views

Batch = tuple[Views, list[Targets], tuple[Views, Targets] | None]
"""Views, the targets of view 0, 1, ... as reference, and single photos with their labels."""


@dataclass(frozen=True)
class TrainConfig:
    """How a run is driven; the optimiser and the loss have their own."""

    batch_size: int = 8
    """Samples a step, all processes together (Sec. 4.1: 8)."""
    seed: int = 0
    precision: str = "auto"
    """Lightning's name, as 32-true or bf16-mixed; auto: bf16-mixed where the hardware has it."""
    sync_batchnorm: bool = True
    """Statistics over the samples of all GPUs (the paper has two samples on each and is silent).
    On CPUs, which have no such layer, every process normalises its own share."""
    val_every: int = 1000
    """Steps between looks at the validation scenes."""
    checkpoint_every: int = 250
    """Steps between checkpoints a killed run can go on from."""
    parts: tuple[str, ...] = ()
    """Modules that learn, by their names in the model, as `cascade.regularizers.0 prior`; all
    others stay as they are, with the statistics of their batch norms. The loss must reach each.
    Empty: whatever the model lets learn."""
    checkpoint_stages: bool = False
    """Keep no cost volume of the cascade for the backward pass, which computes each again: less
    memory, more time, the same gradients."""
    singles_weight: float = 1.0
    """Weight of the labelled single photos' loss beside that of the tuples (`DataConfig.singles`).
    """


class TrainingModule(LightningModule):
    """Wraps a model for training; the reference moves over the first views of each sample.

    depth_range: metres; validation counts the pixels inside it. parts: as of `TrainConfig`; the
    parameters of all others no longer ask for gradients.
    """

    def __init__(
        self,
        model: nn.Module,
        loss: Loss,
        optimizer: OptimizerConfig,
        depth_range: tuple[float, float],
        singles_weight: float = 1.0,
        parts: Sequence[str] = (),
    ):
        super().__init__()
        self.model = model
        self.loss = loss
        self.optimizer_config = optimizer
        self.depth_range = depth_range
        self.singles_weight = singles_weight
        self.parts = tuple(parts)
        for name, parameter in model.named_parameters():
            if not self._learns(name):
                parameter.requires_grad_(False)

    def train(self, mode: bool = True) -> "TrainingModule":
        """As of any module, but that parts which do not learn stay in evaluation mode."""
        super().train(mode)
        for name, module in self.model.named_modules():
            if not self._learns(name):
                module.training = False  # it alone: what it holds may learn
        return self

    def _learns(self, name: str) -> bool:
        """Whether a module or parameter of that name belongs to the parts that learn."""
        return not self.parts or any(f"{name}.".startswith(f"{part}.") for part in self.parts)

    def on_train_start(self) -> None:
        """Says `train()`, which Lightning does not: frozen parts then go to evaluation mode."""
        self.train()

    def training_step(self, batch: Batch, batch_index: int) -> Tensor:
        """Mean of the loss over the references of the sample, plus that of its single photos."""
        views, targets, singles = batch
        losses = [
            self.loss(prediction, target, views.depth_range)
            for prediction, target in zip(
                predict_references(self.model, views, len(targets)), targets, strict=True
            )
        ]
        means = {name: torch.stack([parts[name] for parts in losses]).mean() for name in losses[0]}
        for name, mean in means.items():
            self.log(f"train/{name}", mean, prog_bar=True)
        if singles is None:
            return means["loss"]
        return means["loss"] + self.singles_weight * self._loss_of_singles(*singles)

    def _loss_of_singles(self, views: Views, targets: Targets) -> Tensor:
        """Of their labels, and of the prior; measured depth is the decoder's prompt."""
        prediction = self.model.segment(views)  # pyright: ignore[reportCallIssue]
        loss = self.loss(prediction, targets, views.depth_range)["loss"]
        self.log("train/singles", loss, prog_bar=True)
        return loss

    def on_validation_epoch_start(self) -> None:
        self.scores: dict[str, SceneScores] = {}

    def validation_step(self, batch: tuple[list[str], Views, Targets], batch_index: int) -> None:
        scenes, views, targets = batch
        size = (views.width, views.height)
        protocol = Protocol("validation", size=size, depth_range=self.depth_range)
        prediction = self.model(views)
        for item, scene in enumerate(scenes):
            scores = score_item(prediction, targets, item, protocol)
            self.scores[scene] = self.scores.get(scene, SceneScores()) + scores

    def on_validation_epoch_end(self) -> None:
        """Scores over all processes; a scene that two of them looked at counts once."""
        scenes = _of_all_processes(self.scores)
        # In one order, so that rounding does not depend on who looked at which.
        scores = sum((scenes[name] for name in sorted(scenes)), SceneScores()).as_json()
        for name in ("rel", "miou"):
            if scores[name] is not None:
                self.log(f"val/{name}", scores[name], prog_bar=True, sync_dist=True)

    def configure_optimizers(self):  # pyright: ignore[reportIncompatibleMethodOverride]
        optimizer, schedule = make_optimizer(self.model, self.optimizer_config)
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": schedule, "interval": "step"},
        }


def _of_all_processes(own: dict[str, SceneScores]) -> dict[str, SceneScores]:
    if not (torch.distributed.is_available() and torch.distributed.is_initialized()):
        return own
    shares: list = [None] * torch.distributed.get_world_size()
    torch.distributed.all_gather_object(shares, own)
    return {name: scores for share in shares for name, scores in share.items()}


def predict_references(model: nn.Module, views: Views, num_references: int) -> list[Prediction]:
    """Predictions for view 0, 1, ...; a model with `encode` and `decode` encodes only once."""
    if num_references == 1:
        return [model(views)]
    if not isinstance(model, EncodesViews):
        return [model(views.with_reference(reference)) for reference in range(num_references)]
    features = model.encode(views)
    return [model.decode(features, views, reference) for reference in range(num_references)]
