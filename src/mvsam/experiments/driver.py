"""Trains an experiment: data, checkpoints, exact resume, logs, and the weights at the end."""

import logging
from dataclasses import replace
from pathlib import Path

import torch
from lightning import Callback, Trainer, seed_everything
from lightning.pytorch.callbacks import LearningRateMonitor, ModelCheckpoint
from lightning.pytorch.loggers import CSVLogger, TensorBoardLogger
from lightning.pytorch.utilities import rank_zero_only

from mvsam.build import build
from mvsam.data.labels import SCANNET20, ClassTable
from mvsam.device import find_device
from mvsam.encoders.attention import use_plain_attention
from mvsam.encoders.sam import cache_frozen_features
from mvsam.experiments.checks import (
    cascade_of,
    check_model,
    check_settings,
    check_truth,
    classes_of,
    recorded_beginning,
    warn_of_changes,
)
from mvsam.experiments.config import Experiment, ModelConfig
from mvsam.experiments.loaders import ExperimentData
from mvsam.experiments.pictures import ValidationPictures
from mvsam.experiments.quiet import quiet_lightning
from mvsam.experiments.stopping import SafeStop, early_end
from mvsam.experiments.throughput import Throughput
from mvsam.memory import keep_freed_memory
from mvsam.precision import has_native_bfloat16
from mvsam.provenance import commit
from mvsam.training.module import TrainingModule
from mvsam.types import Model
from mvsam.weights import (
    ASSETS,
    RUN_PAGE,
    file_hash,
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
WEIGHTS = "model.safetensors"
"""There too: what it trained."""


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
    num_processes = devices * num_nodes
    check_settings(experiment, num_processes)
    check_truth(experiment)
    device = find_device(accelerator, "--accelerator")
    _prepare_process(experiment.train.seed, device, devices)
    classes = classes_of(experiment)
    experiment = _with_classes(experiment, len(classes))
    last = _checkpoint_to_resume(folder)
    if last is not None:
        warn_of_changes(experiment, folder / RUN_PAGE)
    model = _model_of_run(experiment, device, is_resumed=last is not None)
    began_with = recorded_beginning(folder / RUN_PAGE) if last is not None else None
    began_with = began_with or first_weights(experiment.model, model.backbone_weights)
    rank_zero_only(experiment.save)(folder / RUN_PAGE, classes, began_with, device)

    module = _training_module(experiment, model)
    data = ExperimentData(experiment, num_processes)
    stop = SafeStop(folder / LAST)
    callbacks = [stop, Throughput(), LearningRateMonitor("step"), ValidationPictures(classes)]
    with quiet_lightning(), early_end(stop):
        trainer = _trainer(experiment, folder, device, devices, num_nodes, callbacks, progress)
        trainer.fit(module, data, ckpt_path=last, weights_only=True)

    target = folder / WEIGHTS
    if trainer.is_global_zero:
        _save_weights(model, target, experiment, classes, trainer.global_step, began_with)
    return target


def _prepare_process(seed: int, device: str, devices: int) -> None:
    seed_everything(seed, workers=True, verbose=False)
    if device == "cpu":
        keep_freed_memory()
    if device == "cpu" and devices > 1:
        torch.set_num_threads(1)  # two threads in each of two processes wait for each other


def _with_classes(experiment: Experiment, num_classes: int) -> Experiment:
    """The experiment for data of so many classes, without class weights that are of others.

    The runs of the package weigh the classes of the rooms; on a user's own classes all count alike.
    """
    experiment = replace(experiment, model=replace(experiment.model, num_classes=num_classes))
    weights = getattr(experiment.loss, "class_weights", None)
    if weights is None or len(weights) == num_classes:
        return experiment
    log.warning(
        "the run weighs %d classes and the data have %d: all of them count alike.",
        len(weights),
        num_classes,
    )
    loss = replace(experiment.loss, class_weights=None)  # pyright: ignore
    return replace(experiment, loss=loss)


def _checkpoint_to_resume(folder: Path) -> Path | None:
    """`folder/last.ckpt` if it is there; InputError if it cannot be read."""
    last = folder / LAST
    if not last.exists():
        return None
    read_tensors(last)
    return last


def _model_of_run(experiment: Experiment, device: str, is_resumed: bool) -> Model:
    """What is trained; InputError where it does not fit the data.

    A checkpoint holds every weight: the files a resumed run began with need not exist any more, but
    for ImageNet's, whose layers a model may treat otherwise.
    """
    config = experiment.model.without_files() if is_resumed else experiment.model
    model = initial_model(config, device)
    check_model(experiment, model)
    model.input_size = experiment.data.size
    model.semantic_size = experiment.data.semantic_size
    if experiment.train.checkpoint_stages:
        cascade_of(model, experiment).checkpoint_stages = True
    return model


def _training_module(experiment: Experiment, model: Model) -> TrainingModule:
    return TrainingModule(
        model,
        experiment.loss,
        experiment.optimizer,
        experiment.data.depth_range,
        experiment.train.singles_weight,
        experiment.train.parts,
    )


def _save_weights(
    model: Model,
    target: Path,
    experiment: Experiment,
    classes: ClassTable,
    steps: int,
    began_with: str,
) -> None:
    save(
        model,
        target,
        name=experiment.model.name,
        depth_range=experiment.data.depth_range,
        classes=classes.names,
        palette=classes.colors,
        training={
            "run": experiment.name,
            "steps": steps,
            "commit": commit(),
            "began_with": began_with,
            "backbone_weights": model.backbone_weights,
        },
    )


def first_weights(config: ModelConfig, backbone: str) -> str:
    """What a model began with, in a few words: names of runs and files, else "random".

    Weights that come with the package change from version to version: their hash goes with them.
    """
    names = [_name_of(Path(path)) for path in config.beginnings]
    if backbone != "random":
        names.append(backbone)
    return " + ".join(names) or "random"


def _name_of(path: Path) -> str:
    packaged = ASSETS / f"{path}.safetensors"
    if packaged.exists():
        return f"{path} {file_hash(packaged)[:8]}"
    return path.parent.name if path.stem == "model" else path.stem


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
