"""Trains an experiment: data, checkpoints, exact resume, logs, and the weights at the end."""

import json
import logging
import warnings
from dataclasses import replace
from pathlib import Path

import torch
from lightning import LightningDataModule, Trainer, seed_everything
from lightning.pytorch.callbacks import LearningRateMonitor, ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from lightning.pytorch.utilities import rank_zero_only
from torch.utils.data import DataLoader

from mvsam.build import build
from mvsam.data.dataset import TupleDataset, collate, open_data
from mvsam.data.labels import SCANNET20, ClassTable
from mvsam.data.stream import Onward, SampleStream, collate_training
from mvsam.errors import InputError
from mvsam.experiments.config import Experiment, ModelConfig
from mvsam.experiments.pictures import ValidationPictures
from mvsam.model import MultiViewSAM
from mvsam.precision import has_native_bfloat16
from mvsam.provenance import commit
from mvsam.training.module import TrainingModule
from mvsam.weights import (
    RUN_PAGE,
    layout_channels_last,
    load_into,
    load_sam,
    read_tensors,
    save,
)

log = logging.getLogger("mvsam")


def train(
    experiment: Experiment,
    folder: Path,
    devices: int = 1,
    num_nodes: int = 1,
    accelerator: str = "auto",
    progress: bool = True,
) -> Path:
    """Trains to the last step, going on from `folder/last.ckpt` where there is one.

    Returns the path of the trained weights. One process a device; on several nodes start the same
    command on each with the variables Lightning reads (MASTER_ADDR, NODE_RANK, ...).
    """
    _check(experiment, devices * num_nodes)
    seed_everything(experiment.train.seed, workers=True, verbose=False)
    if not torch.cuda.is_available() and devices > 1:
        torch.set_num_threads(1)  # two threads in each of two processes wait for each other
    classes = classes_of(experiment)
    if experiment.model.num_classes is None:
        experiment = replace(experiment, model=replace(experiment.model, num_classes=len(classes)))
    last = _checkpoint_to_resume(folder)
    if last is not None:
        warn_of_changes(experiment, folder / RUN_PAGE)
        # The checkpoint holds every weight; the files the run began with need not exist any more.
        model = initial_model(replace(experiment.model, init=(), sam_checkpoint=None))
    else:
        model = initial_model(experiment.model)
    rank_zero_only(experiment.save)(folder / RUN_PAGE, classes)
    module = TrainingModule(
        model, experiment.loss, experiment.optimizer, experiment.data.depth_range
    )
    trainer = _trainer(experiment, folder, devices, num_nodes, accelerator, progress)
    data = ExperimentData(experiment, devices * num_nodes)
    with warnings.catch_warnings():
        _silence_lightning()
        trainer.fit(module, data, ckpt_path=last, weights_only=True)
    target = folder / "model.safetensors"
    if trainer.is_global_zero:
        steps = trainer.global_step
        save(
            module.model,
            target,
            name=experiment.model.name,
            depth_range=experiment.data.depth_range,
            classes=classes.names,
            palette=classes.colors,
            training={"run": experiment.name, "steps": steps, "commit": commit()},
        )
    return target


def _checkpoint_to_resume(folder: Path) -> Path | None:
    """`folder/last.ckpt` if it is there; InputError if it cannot be read."""
    last = folder / "last.ckpt"
    if not last.exists():
        return None
    read_tensors(last)
    return last


def warn_of_changes(experiment: Experiment, page: Path) -> None:
    """Says which settings differ from those the run began with."""
    if not page.exists():
        return
    before, now = json.loads(page.read_text()), experiment.as_json()
    for group, settings in now.items():
        if not isinstance(settings, dict):
            continue
        for name, value in settings.items():
            old = before.get(group, {}).get(name)
            if old != value:
                log.warning("%s: goes on with %s.%s %s, not %s.", page, group, name, value, old)


def classes_of(experiment: Experiment) -> ClassTable:
    """The classes of the training scenes: those a folder brings, else ScanNet's 20."""
    first = open_data(experiment.data.train)[0]
    classes = getattr(first, "classes", SCANNET20)
    wanted = experiment.model.num_classes
    if wanted not in (None, len(classes)):
        raise InputError(
            f"run {experiment.name}: --model.num-classes {wanted}, but {experiment.data.train} has "
            f"{len(classes)} classes; leave the option out."
        )
    watched = getattr(open_data(experiment.data.val)[0], "classes", SCANNET20)
    if watched.names != classes.names:
        raise InputError(
            f"run {experiment.name}: {experiment.data.val} has other classes than "
            f"{experiment.data.train}; give scenes of the same classes as --data.val."
        )
    return classes


def initial_model(config: ModelConfig) -> MultiViewSAM:
    """The model of a run before its first step."""
    options = {} if config.tuned_blocks is None else {"tuned_blocks": config.tuned_blocks}
    model = build(config.name, config.num_classes or len(SCANNET20), **options)
    if config.sam_checkpoint:
        load_sam(model, config.sam_checkpoint, config.sam_decoder)
    for name in config.init:
        anew = load_into(model, name)
        if anew:
            total = len(model.state_dict())
            log.warning("%s: has %d of the model's %d entries.", name, total - len(anew), total)
    if not torch.cuda.is_available():
        use_plain_attention(model)
    return layout_channels_last(model)


def use_plain_attention(model: MultiViewSAM) -> None:
    """Attention written out: on a CPU twice as fast forward and backward as the fused one, which
    has no fast backward with SAM's relative positions (docs/log.md)."""
    if model.semantic_encoder is not None:
        for block in model.semantic_encoder.backbone.blocks:
            block.attn.fused_attn = False  # pyright: ignore


class ExperimentData(LightningDataModule):
    """The sample stream, begun where a resumed run stopped, and the validation tuples."""

    def __init__(self, experiment: Experiment, num_processes: int):
        super().__init__()
        self.experiment = experiment
        self.num_processes = num_processes
        self.next_sample = 0

    def train_dataloader(self) -> DataLoader:
        data, train = self.experiment.data, self.experiment.train
        assert self.trainer is not None
        share = train.batch_size // self.num_processes
        return DataLoader(
            SampleStream(data, train.seed),
            batch_size=share,
            sampler=Onward(self.next_sample + self.trainer.global_rank, self.num_processes),
            num_workers=data.workers,
            collate_fn=collate_training,
            prefetch_factor=4 if data.workers else None,
            multiprocessing_context="spawn" if data.workers else None,
        )

    def val_dataloader(self) -> DataLoader:
        data = self.experiment.data
        # Every process looks at all of them: unequal shares would wait for each other for ever.
        tuples = TupleDataset(
            open_data(data.val), data.num_views, data.size, data.depth_range, tuples_per_scene=1
        )
        return DataLoader(tuples, batch_size=1, collate_fn=collate)

    def state_dict(self) -> dict:
        assert self.trainer is not None
        return {"next_sample": self.trainer.global_step * self.experiment.train.batch_size}

    def load_state_dict(self, state_dict: dict) -> None:
        self.next_sample = state_dict["next_sample"]


def precision_of(name: str) -> str:
    """Lightning's precision for "auto": bf16-mixed where the device multiplies it natively."""
    if name != "auto":
        return name
    device = "cuda" if torch.cuda.is_available() else "cpu"
    return "bf16-mixed" if has_native_bfloat16(device) else "32-true"


def _trainer(
    experiment: Experiment,
    folder: Path,
    devices: int,
    num_nodes: int,
    accelerator: str,
    progress: bool,
) -> Trainer:
    config = experiment.train
    every = ModelCheckpoint(
        dirpath=folder,
        filename="last",
        every_n_train_steps=config.checkpoint_every,
        save_top_k=1,
        enable_version_counter=False,
        save_on_train_epoch_end=False,
    )
    return Trainer(
        accelerator=accelerator,
        devices=devices,
        num_nodes=num_nodes,
        strategy="ddp" if devices * num_nodes > 1 else "auto",
        precision=precision_of(config.precision),  # pyright: ignore[reportArgumentType]
        max_steps=experiment.optimizer.steps,
        max_epochs=-1,
        gradient_clip_val=experiment.optimizer.gradient_clip,
        val_check_interval=config.val_every,
        check_val_every_n_epoch=None,
        num_sanity_val_steps=0,
        use_distributed_sampler=False,
        sync_batchnorm=config.sync_batchnorm and torch.cuda.is_available(),
        callbacks=[every, LearningRateMonitor("step"), ValidationPictures()],
        logger=[
            TensorBoardLogger(folder, name="", version=""),
            CSVLogger(folder, name="", version=""),
        ],
        log_every_n_steps=10,
        enable_progress_bar=progress,
        enable_model_summary=False,
        default_root_dir=folder,
    )


def _check(experiment: Experiment, num_processes: int) -> None:
    if experiment.train.batch_size % num_processes:
        raise InputError(
            f"run {experiment.name}: a batch of {experiment.train.batch_size} cannot be shared by "
            f"{num_processes} processes; change --train.batch-size."
        )
    if any(side % 32 for side in experiment.data.size):
        raise InputError(
            f"run {experiment.name}: pictures of {experiment.data.size[0]}x"
            f"{experiment.data.size[1]}; both sides of --data.size must be divisible by 32."
        )
    if experiment.data.references > experiment.data.num_views:
        raise InputError(
            f"run {experiment.name}: {experiment.data.references} references of "
            f"{experiment.data.num_views} views; at most every view can serve once."
        )


def _silence_lightning() -> None:
    """Advice that does not apply: the stream goes on exactly where it stopped."""
    for text in (".*does not have many workers.*", ".*resuming from a checkpoint.*"):
        warnings.filterwarnings("ignore", text)
