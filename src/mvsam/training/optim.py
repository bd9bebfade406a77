"""The paper's optimiser: AdamW, a slower group for the tuned SAM blocks, warm-up and milestones."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import nn


@dataclass(frozen=True)
class OptimizerConfig:
    """AdamW and its schedule (Sec. 4.1)."""

    lr: float = 1e-3
    sam_lr: float = 1e-4
    """For the tuned blocks of a pre-trained SAM encoder."""
    weight_decay: float = 1e-2
    betas: tuple[float, float] = (0.9, 0.999)
    steps: int = 100_000
    """Optimiser steps of the whole run."""
    milestones: tuple[float, ...] = (10 / 16, 12 / 16, 14 / 16)
    """Shares of the run after which the rate is halved. The paper gives no schedule; CasMVSNet's
    epochs 10, 12 and 14 of the same 16."""
    gradient_clip: float | None = None
    """Largest norm of the gradient; the paper mentions none."""


def parameter_groups(model: nn.Module, config: OptimizerConfig) -> list[dict]:
    """What learns, in two groups: tuned blocks of a pre-trained SAM, and the rest."""
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
    """Factor on the learning rate at a step: warm-up from 1/3, then halved at each milestone.

    The warm-up takes min(500, 2 %) steps.
    """
    warmup = max(1, min(500, round(0.02 * config.steps)))
    edges = [share * config.steps for share in config.milestones]

    def factor(step: int) -> float:
        if step < warmup:
            return 1 / 3 + 2 / 3 * step / warmup
        return 0.5 ** sum(step >= edge for edge in edges)

    return factor


def make_optimizer(
    model: nn.Module, config: OptimizerConfig
) -> tuple[torch.optim.AdamW, torch.optim.lr_scheduler.LambdaLR]:
    """The optimiser and its schedule, to be stepped once a batch."""
    optimizer = torch.optim.AdamW(
        parameter_groups(model, config), betas=config.betas, weight_decay=config.weight_decay
    )
    return optimizer, torch.optim.lr_scheduler.LambdaLR(optimizer, rate_factor(config))
