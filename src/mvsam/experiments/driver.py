"""Trains an experiment: data, checkpoints, exact resume, logs, and the weights at the end."""

import logging
import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import torch
from lightning import Callback, Trainer, seed_everything
from lightning.pytorch.callbacks import LearningRateMonitor, ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from lightning.pytorch.utilities import rank_zero_only
from lightning.pytorch.utilities.exceptions import SIGTERMException

from mvsam.build import build
from mvsam.data.labels import SCANNET20
from mvsam.encoders.attention import use_plain_attention
from mvsam.encoders.sam import cache_frozen_features
from mvsam.errors import InputError
from mvsam.experiments.checks import check_model, check_settings, classes_of, warn_of_changes
from mvsam.experiments.config import Experiment, ModelConfig
from mvsam.experiments.loaders import ExperimentData
from mvsam.experiments.pictures import ValidationPictures
from mvsam.experiments.stopping import SafeStop
from mvsam.experiments.throughput import Throughput
from mvsam.memory import keep_freed_memory
from mvsam.precision import has_native_bfloat16
from mvsam.provenance import commit
from mvsam.training.module import TrainingModule
from mvsam.types import Model
from mvsam.weights import (
    RUN_PAGE,
    layout_channels_last,
    load_encoder,
    load_into,
    load_sam,
    read_tensors,
    save,
)

log = logging.getLogger("mvsam")

LAST = "last.ckpt"
"""In a run's folder: the checkpoint it goes on from."""


def train(
    experiment: Experiment,
    folder: Path,
    devices: int = 1,
    num_nodes: int = 1,
    accelerator: str = "auto",
    progress: bool = True,
) -> Path:
    """Trains to the last step, going on from `folder/last.ckpt` where there is one.

    Returns the path of the trained weights. Stopped early, by Ctrl-C (KeyboardInterrupt), SIGTERM
    (SystemExit) or an error, it leaves a checkpoint of its last step there. One process a device;
    on several nodes start the same command on each with the variables Lightning reads
    (MASTER_ADDR, NODE_RANK, ...).
    """
    check_settings(experiment, devices * num_nodes)
    device = device_of(accelerator)
    seed_everything(experiment.train.seed, workers=True, verbose=False)
    if device == "cpu":
        keep_freed_memory()
    if device == "cpu" and devices > 1:
        torch.set_num_threads(1)  # two threads in each of two processes wait for each other
    classes = classes_of(experiment)
    if experiment.model.num_classes is None:
        experiment = replace(experiment, model=replace(experiment.model, num_classes=len(classes)))
    last = _checkpoint_to_resume(folder)
    if last is not None:
        warn_of_changes(experiment, folder / RUN_PAGE)
        # The checkpoint holds every weight; the files the run began with need not exist any more.
        model = initial_model(experiment.model.without_files(), device)
    else:
        model = initial_model(experiment.model, device)
    check_model(experiment, model)
    model.semantic_size = experiment.data.semantic_size
    rank_zero_only(experiment.save)(folder / RUN_PAGE, classes)
    module = TrainingModule(
        model,
        experiment.loss,
        experiment.optimizer,
        experiment.data.depth_range,
        experiment.train.singles_weight,
    )
    stop = SafeStop(folder / LAST)
    callbacks = [stop, Throughput(), LearningRateMonitor("step"), ValidationPictures(classes)]
    data = ExperimentData(experiment, devices * num_nodes)
    with _quiet_lightning(), _early_end(stop):
        trainer = _trainer(experiment, folder, device, devices, num_nodes, callbacks, progress)
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
            training={
                "run": experiment.name,
                "steps": steps,
                "commit": commit(),
                "backbone_weights": model.backbone_weights,
            },
        )
    return target


@contextmanager
def _early_end(stop: SafeStop) -> Iterator[None]:
    """Lets `stop` hear Ctrl-C, and ends as Python does: Lightning makes a SystemExit of it."""
    try:
        with stop.listening():
            yield
    except SIGTERMException as error:
        raise SystemExit(128 + signal.SIGTERM) from error
    except (SystemExit, RuntimeError) as error:
        if not stop.is_asked:
            raise
        # A RuntimeError: Ctrl-C ended a data worker that was just starting.
        raise KeyboardInterrupt from error


def _checkpoint_to_resume(folder: Path) -> Path | None:
    """`folder/last.ckpt` if it is there; InputError if it cannot be read."""
    last = folder / LAST
    if not last.exists():
        return None
    read_tensors(last)
    return last


def device_of(accelerator: str) -> str:
    """Where a run with this option trains, "cuda" or "cpu"; InputError where there is no GPU."""
    has_gpu = torch.cuda.is_available()
    if accelerator == "gpu" and not has_gpu:
        raise InputError("no CUDA device was found: leave --accelerator out to use the processor.")
    return "cuda" if has_gpu and accelerator != "cpu" else "cpu"


def initial_model(config: ModelConfig, device: str = "cpu") -> Model:
    """The model of a run before its first step, to be trained on `device` ("cpu" or "cuda")."""
    given = {"tuned_blocks": config.tuned_blocks, "imagenet": config.imagenet}
    options = {name: value for name, value in given.items() if value is not None}
    model = build(config.name, config.num_classes or len(SCANNET20), **options)
    if config.sam_checkpoint:
        load_sam(model, config.sam_checkpoint, config.sam_decoder)
    if config.semantic_encoder:
        load_encoder(model, config.semantic_encoder)
    for name in config.init:
        anew = load_into(model, name)
        if anew:
            total = len(model.state_dict())
            log.warning("%s: has %d of the model's %d entries.", name, total - len(anew), total)
    if config.feature_cache is not None:
        cache_frozen_features(model, Path(config.feature_cache))
    if device == "cpu":
        use_plain_attention(model)
    return layout_channels_last(model)


def precision_of(name: str, device: str) -> str:
    """Lightning's precision for "auto": bf16-mixed where the device multiplies it natively."""
    if name != "auto":
        return name
    return "bf16-mixed" if has_native_bfloat16(device) else "32-true"


def _trainer(
    experiment: Experiment,
    folder: Path,
    device: str,
    devices: int,
    num_nodes: int,
    callbacks: list[Callback],
    progress: bool,
) -> Trainer:
    config = experiment.train
    every = ModelCheckpoint(
        dirpath=folder,
        filename=Path(LAST).stem,
        every_n_train_steps=config.checkpoint_every,
        save_top_k=1,
        enable_version_counter=False,
        save_on_train_epoch_end=False,
    )
    return Trainer(
        accelerator=device,
        devices=devices,
        num_nodes=num_nodes,
        strategy="ddp" if devices * num_nodes > 1 else "auto",
        precision=precision_of(config.precision, device),  # pyright: ignore[reportArgumentType]
        max_steps=experiment.optimizer.steps,
        max_epochs=-1,
        gradient_clip_val=experiment.optimizer.gradient_clip,
        val_check_interval=config.val_every,
        check_val_every_n_epoch=None,
        num_sanity_val_steps=0,
        use_distributed_sampler=False,
        sync_batchnorm=config.sync_batchnorm and device == "cuda",
        callbacks=[every, *callbacks],
        logger=[
            TensorBoardLogger(folder, name="", version=""),
            CSVLogger(folder, name="", version=""),
        ],
        log_every_n_steps=10,
        enable_progress_bar=progress,
        enable_model_summary=False,
        default_root_dir=folder,
    )


@contextmanager
def _quiet_lightning() -> Iterator[None]:
    """Leaves out its advertisements, and advice that does not apply.

    The stream goes on exactly where it stopped, and a folder that is not empty is how a run goes
    on.
    """
    loggers = [logging.getLogger(name) for name in ("lightning.pytorch", "lightning.fabric")]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        for text in _NEEDLESS:
            warnings.filterwarnings("ignore", text)
        for logger in loggers:
            logger.setLevel(logging.WARNING)
        try:
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)


_NEEDLESS = (
    ".*does not have many workers.*",
    ".*resuming from a checkpoint.*",
    ".*exists and is not empty.*",
    ".*LeafSpec.*",
    ".*persistent_workers.*",
)
