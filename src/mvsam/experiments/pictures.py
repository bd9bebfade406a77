"""Pictures for TensorBoard: what the model makes of the first validation tuple."""

import torch
from jaxtyping import Float, Int
from lightning import Callback, LightningModule, Trainer
from lightning.pytorch.loggers import TensorBoardLogger
from torch import Tensor

from mvsam.data.labels import ClassTable, colorize


class ValidationPictures(Callback):
    """Photo, depth and labels of one validation sample, prediction above ground truth."""

    def __init__(self, classes: ClassTable):
        self.classes = classes

    def on_validation_batch_end(
        self, trainer: Trainer, pl_module: LightningModule, outputs, batch, batch_idx: int, *_
    ) -> None:
        loggers = [x for x in trainer.loggers if isinstance(x, TensorBoardLogger)]
        if batch_idx or not loggers or not trainer.is_global_zero:
            return
        _, views, targets = batch
        prediction = pl_module.model(views)  # pyright: ignore[reportCallIssue]
        top, bottom = [views.images[0, 0]], [views.images[0, 0]]
        if prediction.depth is not None:
            far = float(views.depth_range[0, 1])
            top.append((prediction.depth[0] / far).clamp(0, 1).expand(3, -1, -1))
            bottom.append((targets.depth[0] / far).clamp(0, 1).expand(3, -1, -1))
        if prediction.labels is not None:
            top.append(self._label_picture(prediction.labels[0]))
            bottom.append(self._label_picture(targets.labels[0]))
        picture = torch.cat(
            [torch.cat([x.float().cpu() for x in row], -1) for row in (top, bottom)], -2
        )
        for logger in loggers:
            logger.experiment.add_image("val/first", picture, trainer.global_step)

    def _label_picture(
        self, labels: Int[Tensor, "height width"]
    ) -> Float[Tensor, "3 height width"]:
        """In the colours of the classes, 0..1."""
        colors = colorize(labels.cpu().numpy().astype("uint8"), self.classes)
        return torch.from_numpy(colors).permute(2, 0, 1) / 255
