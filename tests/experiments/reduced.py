"""Runs' models at a size for tests, without the files they begin with."""

from dataclasses import replace
from unittest import mock

import torch

from mvsam.experiments.config import ModelConfig
from mvsam.experiments.driver import initial_model
from mvsam.model import MultiViewSAM
from mvsam.types import Model
from tests.small import SIDE, small_backbone


def bare(config: ModelConfig) -> ModelConfig:
    """The same model with random weights."""
    return replace(config.without_files(), imagenet=None)


def reduced(config: ModelConfig) -> Model:
    """Its first weights, seeded; SAM's encoder is small and sees 64 pixels."""
    torch.manual_seed(0)
    with (
        mock.patch("mvsam.assemblies.paper.sam_vit_b", small_backbone),
        mock.patch("mvsam.assemblies.tiny.TINY_SIDE", SIDE),
    ):
        model = initial_model(bare(config)).train()
    if isinstance(model, MultiViewSAM) and model.semantic_encoder is not None:
        model.semantic_encoder.input_side = SIDE
    return model
