"""Before a run begins: do its settings fit each other, its data, and the run it goes on from?"""

import json
import logging
from difflib import get_close_matches
from pathlib import Path

from mvsam.build import Inputs, model_spec
from mvsam.data.catalog import is_rooms, open_data
from mvsam.data.depth_range import checked_depth_range
from mvsam.data.labels import SCANNET20, ClassTable
from mvsam.data.streaming.config import DataConfig
from mvsam.data.streaming.mixture import parse_sources
from mvsam.errors import InputError
from mvsam.experiments.config import Experiment
from mvsam.mvs.cascade import DepthCascade
from mvsam.types import Model

log = logging.getLogger("mvsam")


def check_settings(experiment: Experiment, num_processes: int) -> None:
    """InputError where settings contradict each other or the number of processes."""
    run, data, batch_size = experiment.name, experiment.data, experiment.train.batch_size
    for option, value in (
        ("--data.num-views", data.num_views),
        ("--data.fewest-views", data.fewest_views),
        ("--data.references", data.references),
        ("--data.singles-per-sample", data.singles_per_sample),
        ("--train.batch-size", batch_size),
        ("--optimizer.steps", experiment.optimizer.steps),
    ):
        if value is not None and value < 1:
            raise InputError(f"run {run}: {option} {value}; give 1 or more.")
    _ = checked_depth_range(data.depth_range)
    if batch_size % num_processes:
        raise InputError(
            f"run {run}: a batch of {batch_size} cannot be shared by {num_processes} processes; "
            "change --train.batch-size."
        )
    if any(side % 32 for side in data.size):
        raise InputError(
            f"run {run}: pictures of {data.size[0]}x{data.size[1]}; both sides of --data.size must "
            "be divisible by 32."
        )
    changes = data.mirror or data.color_jitter or data.singles or data.views_part < 1
    if experiment.model.feature_cache and changes:
        raise InputError(
            f"run {run}: --model.feature-cache keeps features of pictures that come again, and "
            "--data.mirror, --data.color-jitter, --data.views-part and --data.singles (parts of "
            "photos) change them every time; leave one of them out."
        )
    _check_augmentation(run, data)
    fewest = data.num_views if data.fewest_views is None else data.fewest_views
    if data.references > fewest:
        raise InputError(
            f"run {run}: {data.references} references of {fewest} views; at most every view can "
            "serve once."
        )
    if fewest > data.num_views:
        raise InputError(
            f"run {run}: fewest {fewest} of {data.num_views} views; lower --data.fewest-views."
        )
    needed = model_spec(experiment.model.name).fewest_views
    if fewest < needed:
        raise InputError(
            f"run {run}: {experiment.model.name} looks at {needed} photos or more, and --data."
            f"{'num' if data.fewest_views is None else 'fewest'}-views is {fewest}."
        )


def _check_augmentation(run: str, data: DataConfig) -> None:
    """InputError for a spread below 0, a share that is none, a range that ends before it begins."""
    for option, value in (
        ("--data.pose-noise", min(data.pose_noise)),
        ("--data.color-jitter", data.color_jitter),
        ("--data.prompt-noise", data.prompt_noise),
    ):
        if not value >= 0:
            raise InputError(f"run {run}: {option} {value:g}; give 0 or more.")
    for option, share, may_be_0 in (
        ("--data.least-pose-noise-share", data.least_pose_noise_share, True),
        ("--data.views-part", data.views_part, False),
        ("--data.singles-part", data.singles_part, False),
    ):
        if not 0 <= share <= 1 or not (share or may_be_0):
            raise InputError(f"run {run}: {option} {share:g}: give a share, 0 to 1.")
    if data.farthest is not None:
        least, most = data.farthest
        if not data.depth_range[0] < least <= most:
            raise InputError(
                f"run {run}: --data.farthest {least:g} {most:g}; give the nearer first, both "
                f"beyond {data.depth_range[0]:g} m, where the depth range begins."
            )


def check_model(experiment: Experiment, model: Model) -> None:
    """InputError where the model lacks a part that shall learn, or cannot learn from the data.

    For labelled single photos it has to label a picture without predicting its depth.
    """
    parts = dict(model.named_modules())
    for name in experiment.train.parts:
        if name not in parts:
            close = get_close_matches(name, [part for part in parts if part], n=3)
            raise InputError(
                f"run {experiment.name}: --train.parts {name} is no part of "
                f"{experiment.model.name}; the nearest names are {', '.join(close) or 'none'}."
            )
        if not any(parameter.requires_grad for parameter in parts[name].parameters()):
            raise InputError(
                f"run {experiment.name}: --train.parts {name} has nothing that learns; leave it "
                "out."
            )
    if experiment.data.singles is None:
        return
    if getattr(model, "decoder", None) is None:
        raise InputError(
            f"run {experiment.name}: {experiment.model.name} cannot label single photos prompted "
            "with measured depth; leave --data.singles out."
        )
    if model.num_classes != len(SCANNET20):
        raise InputError(
            f"run {experiment.name}: --data.singles have the {len(SCANNET20)} ScanNet classes, the "
            f"model has {model.num_classes}; leave --data.singles out."
        )


def cascade_of(model: Model, experiment: Experiment) -> DepthCascade:
    """The part that `--train.checkpoint-stages` is about; InputError for a model without it."""
    for part in model.children():
        if isinstance(part, DepthCascade):
            return part
    raise InputError(
        f"run {experiment.name}: {experiment.model.name} has no cascade of cost volumes; leave "
        "--train.checkpoint-stages out."
    )


def check_truth(experiment: Experiment) -> None:
    """InputError where the first scenes to train on lack what the model learns from, or reads.

    Said in the log where they lack one of two.
    """
    name = experiment.model.name
    spec = model_spec(name)
    reads_depth = spec.inputs is Inputs.RGBD
    if reads_depth and experiment.data.references > 1:
        raise InputError(
            f"run {experiment.name}: {name} reads measured depth, which each tuple's first photo "
            "alone brings; leave --data.references at 1."
        )
    for source in parse_sources(experiment.data.train):
        has_depth, has_labels = _truth_in(source.name, experiment.data)
        if reads_depth and not has_depth:
            raise InputError(
                f"run {experiment.name}: {name} reads measured depth, and {source.name} has none; "
                "train a model of RGB views (mvsam models)."
            )
        known = {"depth": has_depth, "semantics": has_labels}
        missing = [_FILES[task] for task in spec.tasks if not known[task]]
        if len(missing) == len(spec.tasks):
            raise InputError(
                f"run {experiment.name}: {source.name} has no {' and no '.join(missing)}, which "
                f"{name} learns from (docs/data.md)."
            )
        if missing:
            log.warning("%s has no %s: it teaches the rest alone.", source.name, missing[0])


_FILES = {"depth": "depth maps (depth/)", "semantics": "labels (labels/)"}
_LOOKED_AT = 8
"""Scenes of a source; some may lack what others have."""


def _truth_in(name: str, data: DataConfig) -> tuple[bool, bool]:
    """Whether any frame of the first scenes has depth, and whether any has labels."""
    if is_rooms(name):
        return True, True
    scenes = open_data(name, **data.of_scans(name))
    frames = [
        scene.frame(index)
        for scene in (scenes[place] for place in range(min(len(scenes), _LOOKED_AT)))
        for index in range(len(scene))
    ]
    return (
        any(frame.load_depth is not None for frame in frames),
        any(frame.load_labels is not None for frame in frames),
    )


def classes_of(experiment: Experiment) -> ClassTable:
    """The classes of the training scenes: those a folder brings, else ScanNet's 20."""
    names = [source.name for source in parse_sources(experiment.data.train)]
    data = experiment.data
    tables = [_classes_in(name, data) for name in names]
    classes = tables[0]
    for name, table in zip(names, tables, strict=True):
        if table.names != classes.names:
            raise InputError(
                f"run {experiment.name}: {name} has other classes than {names[0]}; mix scenes of "
                "the same classes."
            )
    wanted = experiment.model.num_classes
    if wanted not in (None, len(classes)):
        raise InputError(
            f"run {experiment.name}: --model.num-classes {wanted}, but {experiment.data.train} has "
            f"{len(classes)} classes; leave the option out."
        )
    watched = _classes_in(data.val, data)
    if watched.names != classes.names:
        raise InputError(
            f"run {experiment.name}: {experiment.data.val} has other classes than "
            f"{experiment.data.train}; give scenes of the same classes as --data.val."
        )
    return classes


def _classes_in(name: str, data: DataConfig) -> ClassTable:
    return getattr(open_data(name, **data.of_scans(name))[0], "classes", SCANNET20)


def recorded_beginning(page: Path) -> str | None:
    """What a run's page says it began with; None where it does not say."""
    return json.loads(page.read_text()).get("began_with") if page.exists() else None


def warn_of_changes(experiment: Experiment, page: Path) -> None:
    """Says which settings differ from those the run began with; InputError for other parts.

    The optimiser's moments would be taken for those of other parameters.
    """
    if not page.exists():
        return
    before, now = json.loads(page.read_text()), experiment.as_json()
    parts = before.get("train", {}).get("parts", [])
    if parts != now["train"]["parts"]:
        raise InputError(
            f"{page}: began with --train.parts {' '.join(parts) or '(all)'}; go on with the same, "
            "or begin another run with these weights (--model.init)."
        )
    for group, settings in now.items():
        if not isinstance(settings, dict):
            continue
        known = before.get(group, {})
        for name, value in settings.items():
            old = known.get(name, value)  # settings of later versions had no say then
            if old != value:
                log.warning("%s: goes on with %s.%s %s, not %s.", page, group, name, value, old)
