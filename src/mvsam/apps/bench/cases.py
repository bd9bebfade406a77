"""What is measured: one `Case` a row, and pictures and truth to feed it."""

from dataclasses import dataclass
from typing import Literal

import torch

from mvsam.build import ASSEMBLIES, Inputs, model_spec
from mvsam.errors import InputError
from mvsam.types import Targets, Views

FormName = Literal["ours", "textbook"]
"""ours: as the product runs. textbook: the same weights as published code runs them."""
Work = Literal["predict", "train"]
"""predict: photos to maps. train: forward, backward and optimiser step, a batch of one."""


@dataclass(frozen=True)
class Case:
    """One row of the benchmark."""

    model: str
    form: FormName = "ours"
    work: Work = "predict"
    precision: Literal["float32", "bfloat16"] = "float32"
    num_views: int = 3
    num_references: int = 1
    """How many views serve as reference in turn."""
    width: int = 320
    height: int = 256
    num_planes: tuple[int, ...] | None = None
    """Hypotheses of each stage of a cascade, coarse to fine; None: the model's own."""
    repeats: int = 3
    device: Literal["cpu", "cuda"] = "cpu"


def is_sound(case: Case) -> bool:
    """False for textbook training in bfloat16 on a CPU: gradients are wrong there or memory is
    corrupted (docs/log.md), so its seconds say nothing."""
    in_bfloat16 = case.precision == "bfloat16" and case.device == "cpu"
    return not (in_bfloat16 and case.form == "textbook" and case.work == "train")


def check_case(case: Case) -> None:
    """InputError for what cannot be measured; asked before minutes are spent."""
    model_spec(case.model)
    if case.model not in ASSEMBLIES and (case.form == "textbook" or case.work == "train"):
        raise InputError(
            f"{case.model} is measured in one way only: add --forms ours --work predict."
        )
    if case.width % 32 or case.height % 32:
        raise InputError(
            f"pictures of {case.width}x{case.height}: --width and --height must be divisible by 32."
        )
    if case.num_views < 1 or case.repeats < 1:
        raise InputError("--views and --repeats must be 1 or more.")


def most_references(model: str, num_views: int) -> int:
    """Every view can be the reference; a measured depth belongs to view 0 alone."""
    return 1 if _reads_depth(model) else num_views


def _reads_depth(model: str) -> bool:
    return model_spec(model).inputs is Inputs.RGBD


def synthetic_views(case: Case) -> Views:
    """Random pictures from cameras 10 cm apart; speed does not depend on what they show."""
    count, width, height = case.num_views, case.width, case.height
    focal = 0.9 * width
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    world_from_cam = torch.eye(4).repeat(count, 1, 1)
    world_from_cam[:, 0, 3] = 0.1 * torch.arange(count)
    return Views(
        images=torch.rand(1, count, 3, height, width),
        intrinsics=intrinsics.expand(1, count, 3, 3),
        world_from_cam=world_from_cam[None],
        depth_range=torch.tensor([[0.1, 5.0]]),
        measured_depth=torch.full((1, height, width), 2.0) if _reads_depth(case.model) else None,
    )


def synthetic_targets(case: Case, num_classes: int = 20) -> Targets:
    """Truth for a training step: every pixel has a depth and a label."""
    size = (1, case.height, case.width)
    return Targets(depth=0.5 + 4 * torch.rand(size), labels=torch.randint(num_classes, size))
