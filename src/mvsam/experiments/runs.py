"""Every trained run, once. `mvsam train NAME` repeats it.

A run that begins with `tiny` begins with the weights that the package holds when it starts; which
those were is in its record (`began_with`). No run of today trains `tiny` from random weights: its
card lists the stages of earlier days.
"""

from dataclasses import replace
from difflib import get_close_matches

from mvsam.data.streaming.config import DataConfig
from mvsam.errors import InputError
from mvsam.experiments.config import Experiment, ModelConfig
from mvsam.experiments.rows import Budget, RowRun, rooms_runs, scannet_runs
from mvsam.training.losses import JointLoss
from mvsam.training.module import TrainConfig
from mvsam.training.optim import OneCycle, OptimizerConfig

_ROOMS = DataConfig(
    train="rooms:train:0-2500",
    references=3,
    room_frames=3,
    mirror=True,
    color_jitter=0.2,
    cache="cache/rooms",
)
_FULL = replace(
    _ROOMS,
    train="0.5 @ rooms:train:0-2500 + 0.5 @ rooms:wide:0-2500",
    num_views=5,
    fewest_views=2,
    room_frames=5,
    references=1,
    farthest=(4.0, 7.0),
    pose_noise=(0.002, 0.05),
)
"""One reference a sample: at full size the cascade costs most, and other rooms teach more. Half of
the views lie as those of real photos, which share half as much as a video's; there are two to five
of them, so that a fifth that sees little does no harm."""
_SINGLE = replace(_ROOMS, num_views=1, references=1)
"""A picture of the three of each room: kept rooms cost nothing the second time, and a picture costs
twice as much to render as to learn from."""

_PROMPTED = replace(_SINGLE, train="rooms:train:0-7500", prompt_noise=0.1)
"""Half of the prompts are wrong, as a plane sweep's depth is."""


def _with_nyu(data: DataConfig) -> DataConfig:
    """Two of NYUv2's labelled photos with each sample, but none of those on which we score."""
    return replace(
        data,
        singles="nyuv2_train",
        singles_per_sample=2,
        singles_without=("nyuv2_heldout", "nyuv2_posed"),
    )


_CLASS_WEIGHTS = (
    0.44, 0.66, 1.03, 1.78, 1.52, 1.62, 1.71, 0.98, 1.21, 1.98,
    2.16, 2.61, 2.15, 1.31, 1.69, 1.57, 3.44, 3.45, 2.38, 2.05,
)  # fmt: skip
"""One over the root of a class's share of the pixels of rooms:train:0-500 (rooms of version 4); the
mean over those pixels is 1. Without them a network from random weights never predicts the rare
third of the classes; `tiny_labels` leaves them out at the end."""
_LOSS = JointLoss(class_weights=_CLASS_WEIGHTS)

_MIXED = (
    "0.35 @ rooms:train:30000-31667 + 0.4 @ rooms:wide:30000-31667 "
    "+ 0.25 @ rooms:around:30000-31667"
)
"""Rooms as they are photographed casually, with wide steps, and around one thing; 5,001 that no
earlier stage saw."""
_KNOWN = "0.4 @ rooms:train:0-1250 + 0.4 @ rooms:wide:0-1250 + 0.2 @ rooms:around:0-324"
"""2,824 rooms that earlier stages saw."""
_LATER_SWEEPS = (
    "cascade.regularizers.1",
    "cascade.regularizers.2",
    *(
        f"geometry_encoder.{name}"
        for name in ("lateral_half", "lateral_full", "out_half", "out_full")
    ),
    *(f"bridge.{name}" for name in ("at_half", "at_full", "out_half", "out_full")),
)
_JOINT = "runs/tiny_joint/model.safetensors"
_SEMANTIC = "runs/tiny_semantic_full/model.safetensors"


_RUNS = (
    Experiment(
        name="tiny_joint",
        about="First stage of `tiny`: both tasks at the size it is used at, all of it learns. "
        "Eleven minutes of an H200 and 16 cores, five of them spent on rendering the rooms.",
        model=ModelConfig("tiny", init=("tiny",)),
        data=replace(_FULL, train=_MIXED),
        loss=_LOSS,
        optimizer=OptimizerConfig(lr=5e-4, steps=2200, gradient_clip=1.0, schedule=OneCycle()),
        train=TrainConfig(batch_size=16, seed=7, val_every=2200, checkpoint_every=200),
    ),
    Experiment(
        name="tiny_semantic_full",
        about="Second stage of `tiny`: its semantic half and its prior once more, on single "
        "pictures prompted with true depth, made wrong half of the time. An hour of a core.",
        model=ModelConfig("tiny_semantic", init=("tiny", _JOINT)),
        data=_PROMPTED,
        loss=_LOSS,
        optimizer=OptimizerConfig(lr=3e-4, steps=2600, gradient_clip=1.0, schedule=OneCycle()),
        train=TrainConfig(batch_size=8, seed=11, val_every=650, checkpoint_every=100),
    ),
    Experiment(
        name="tiny_labels",
        about="Third stage of `tiny`: the same without class weights, which made rare classes win "
        "where they are unlikely. Fifteen minutes of a core.",
        model=ModelConfig("tiny_semantic", init=("tiny", _SEMANTIC)),
        data=_PROMPTED,
        loss=JointLoss(),
        optimizer=OptimizerConfig(lr=2e-4, steps=500, gradient_clip=1.0, schedule=OneCycle()),
        train=TrainConfig(batch_size=8, seed=13, val_every=250, checkpoint_every=100),
    ),
    Experiment(
        name="tiny_sweeps",
        about="Fourth stage of `tiny`: its second and third sweep and what feeds them alone, on "
        "pixels whose depth lies within their windows, from cameras that are right. Under an hour "
        "of two cores.",
        model=ModelConfig("tiny", init=("tiny",)),
        data=replace(_FULL, train=_KNOWN, pose_noise=(0.0005, 0.01)),
        loss=JointLoss(beta=0.005, stage_weights=(0.0, 1.0, 4.0), within_windows=True),
        optimizer=OptimizerConfig(lr=1e-3, steps=600, gradient_clip=1.0, schedule=OneCycle()),
        train=TrainConfig(
            batch_size=8, seed=41, val_every=600, checkpoint_every=25, parts=_LATER_SWEEPS
        ),
    ),
    Experiment(
        name="tiny_context",
        about="Last stage of `tiny`: its context network alone, from first sweeps that stay as "
        "they are. The shipped one saw kept sweeps, several times (benchmarks/kept_sweeps.py).",
        model=ModelConfig("tiny", init=("tiny",)),
        data=replace(_FULL, train=_KNOWN, pose_noise=(0.003, 0.1), least_pose_noise_share=0.0),
        loss=JointLoss(beta=0.02, stage_weights=(1.0, 0.0, 0.0), plane_weight=0.15),
        optimizer=OptimizerConfig(lr=1e-3, steps=4000, gradient_clip=1.0, schedule=OneCycle()),
        train=TrainConfig(
            batch_size=8, seed=101, val_every=1000, checkpoint_every=50, parts=("context",)
        ),
    ),
    Experiment(
        name="tiny",
        about="Both tasks, from the weights that come with the package: to go on with your own "
        "scenes. About ten minutes on two cores.",
        model=ModelConfig("tiny", init=("tiny",)),
        data=_FULL,
        loss=JointLoss(),
        optimizer=OptimizerConfig(lr=1e-4, steps=200, gradient_clip=1.0, schedule=OneCycle()),
        train=TrainConfig(batch_size=4, val_every=100, checkpoint_every=20),
    ),
    Experiment(
        name="tiny_nyu_semantic",
        about="`tiny-nyu`: labels and depth of NYUv2's training photos beside those of rooms, "
        "prompted with measured depth, made wrong half of the time; research terms. "
        "--data.singles says where NYUv2 lies. 1.2 hours of a core beside other work.",
        model=ModelConfig("tiny_semantic", init=("tiny",)),
        data=_with_nyu(_PROMPTED),
        loss=JointLoss(),
        optimizer=OptimizerConfig(lr=4e-4, steps=1200, gradient_clip=1.0, schedule=OneCycle()),
        train=TrainConfig(batch_size=4, seed=17, val_every=400, checkpoint_every=50),
    ),
)
BUDGETS: dict[Budget, dict[str, RowRun]] = {
    "rooms": rooms_runs(_CLASS_WEIGHTS),
    "scannet": scannet_runs(),
}
"""The rows of the tables, by name."""

RUNS = {run.name: run for run in _RUNS} | {
    run.experiment.name: run.experiment for rows in BUDGETS.values() for run in rows.values()
}


def find_run(name: str) -> Experiment:
    """The experiment of that name; InputError lists the names if there is none."""
    if name in RUNS:
        return RUNS[name]
    close = get_close_matches(name, RUNS, n=1)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    raise InputError(f"unknown run '{name}'.{hint} Runs: {', '.join(RUNS)}.")
