"""Optimisers and schedules: the paper's, and those that the baselines' publications train with."""

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, pi
from typing import Any, Protocol, runtime_checkable

import torch
from torch import nn
from torch.optim.lr_scheduler import LambdaLR

ParameterGroups = list[dict[str, Any]]
"""As torch's optimisers take them."""


@runtime_checkable
class Algorithm(Protocol):
    """Makes an optimiser for groups that have their learning rates."""

    def __call__(self, groups: ParameterGroups, weight_decay: float) -> torch.optim.Optimizer: ...


@dataclass(frozen=True)
class AdamW:
    """Adam whose weight decay does not pass through the moments (Sec. 4.1)."""

    betas: tuple[float, float] = (0.9, 0.999)

    def __call__(self, groups: ParameterGroups, weight_decay: float) -> torch.optim.Optimizer:
        return torch.optim.AdamW(groups, betas=self.betas, weight_decay=weight_decay)


@dataclass(frozen=True)
class Adam:
    """Adam; weight decay is a part of the gradient."""

    betas: tuple[float, float] = (0.9, 0.999)

    def __call__(self, groups: ParameterGroups, weight_decay: float) -> torch.optim.Optimizer:
        return torch.optim.Adam(groups, betas=self.betas, weight_decay=weight_decay)


@dataclass(frozen=True)
class SGD:
    """Stochastic gradient descent with momentum."""

    momentum: float = 0.9
    nesterov: bool = False

    def __call__(self, groups: ParameterGroups, weight_decay: float) -> torch.optim.Optimizer:
        return torch.optim.SGD(
            groups, momentum=self.momentum, nesterov=self.nesterov, weight_decay=weight_decay
        )


@runtime_checkable
class Schedule(Protocol):
    """Factor on the learning rates at a step of a run of so many."""

    def __call__(self, step: int, steps: int) -> float: ...


@dataclass(frozen=True)
class Milestones:
    """Warm-up from 1/3, then a cut at each milestone. Without either the rate stays constant."""

    shares: tuple[float, ...] = (10 / 16, 12 / 16, 14 / 16)
    """Of the run, after which the rate is cut. The paper gives no schedule; CasMVSNet's epochs 10,
    12 and 14 of the same 16."""
    factor: float = 0.5
    """What is left after a cut."""
    warmup_steps: int = 500
    """At most; never more than 2 % of the run, and one where there are any."""

    def __call__(self, step: int, steps: int) -> float:
        warmup = min(self.warmup_steps, max(1, round(0.02 * steps)))
        if step < warmup:
            return 1 / 3 + 2 / 3 * step / warmup
        return self.factor ** sum(step >= share * steps for share in self.shares)


@dataclass(frozen=True)
class Polynomial:
    """Down to zero as a power of what is left of the run ("poly")."""

    power: float = 0.9

    def __call__(self, step: int, steps: int) -> float:
        return max(0.0, 1 - step / steps) ** self.power


@dataclass(frozen=True)
class OneCycle:
    """Up to the learning rate and down again, both along half a cosine (Smith & Topin, 2018)."""

    rising: float = 0.1
    """Share of the run."""
    first: float = 1 / 25
    """Factor at the first step."""
    last: float = 1 / (25 * 1e4)
    """Factor at the end."""

    def __call__(self, step: int, steps: int) -> float:
        top = self.rising * steps
        if step < top:
            return _half_cosine(self.first, 1.0, step / top)
        return _half_cosine(1.0, self.last, (step - top) / max(steps - top, 1))


def _half_cosine(begin: float, end: float, share: float) -> float:
    return end + (begin - end) * (1 + cos(pi * min(1.0, share))) / 2


@dataclass(frozen=True)
class OptimizerConfig:
    """How fast what learns (Sec. 4.1 unless a run says otherwise)."""

    lr: float = 1e-3
    sam_lr: float = 1e-4
    """For the tuned blocks of a pre-trained SAM encoder."""
    weight_decay: float = 1e-2
    """Of everything that learns, norms and biases too: Sec. 4.1 makes no exception."""
    steps: int = 100_000
    """Optimiser steps of the whole run."""
    gradient_clip: float | None = None
    """Largest norm of the gradient; the paper mentions none."""
    algorithm: Algorithm = AdamW()
    schedule: Schedule = Milestones()


def parameter_groups(model: nn.Module, config: OptimizerConfig) -> ParameterGroups:
    """What learns and how fast: as the model itself says, or tuned SAM blocks apart."""
    if (own := getattr(model, "parameter_groups", None)) is not None:
        return own(config.lr)
    encoder = getattr(model, "semantic_encoder", None)
    is_pretrained = encoder is not None and encoder.tuned_blocks is not None
    slow = {id(p) for p in encoder.parameters()} if encoder and is_pretrained else set()
    learned = [p for p in model.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in learned if id(p) not in slow], "lr": config.lr},
        {"params": [p for p in learned if id(p) in slow], "lr": config.sam_lr},
    ]
    return [group for group in groups if group["params"]]


def rate_factor(config: OptimizerConfig) -> Callable[[int], float]:
    """Factor on the learning rates at a step."""
    return lambda step: config.schedule(step, config.steps)


def make_optimizer(
    model: nn.Module, config: OptimizerConfig
) -> tuple[torch.optim.Optimizer, LambdaLR]:
    """The optimiser and its schedule, to be stepped once a batch."""
    optimizer = config.algorithm(parameter_groups(model, config), config.weight_decay)
    return optimizer, LambdaLR(optimizer, rate_factor(config))
