"""Every model of `build.py`, ours included: what it predicts, learns, keeps apart and saves."""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import fields, replace
from typing import Any, TypeVar

import pytest
import torch
from torch import Tensor
from torchvision.ops import StochasticDepth

from mvsam.build import ASSEMBLIES, MODELS, Inputs, build
from mvsam.convolution import fold_batch_norm
from mvsam.types import DepthPrior, DepthStage, Model, Prediction, Views
from tests.small import random_views, shuffle_statistics, small_model

HEIGHT, WIDTH = 32, 64

WITHOUT_GRADIENT = {"decoder.no_depth": "depth is known everywhere in these views"}


def small(name: str, seed: int = 0) -> Model:
    """With seeded weights, none of them zero: those would hide what lies behind them."""
    if name in ASSEMBLIES:
        return small_model(name, seed=seed)
    torch.manual_seed(seed)
    model = build(name)
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.eq(0).all():
                parameter.normal_(0, 0.05)
    return model


def views_for(name: str) -> Views:
    measured = MODELS[name].inputs is Inputs.RGBD
    return random_views(batch=2, height=HEIGHT, width=WIDTH, measured=measured)


AnyStruct = TypeVar("AnyStruct", Views, Prediction, DepthStage, DepthPrior)


def item_of(batch: AnyStruct, index: int) -> AnyStruct:
    """One item as a batch of its own."""

    def pick(value: Any) -> Any:
        if isinstance(value, Tensor):
            return value[index : index + 1]
        if isinstance(value, list | tuple):
            return type(value)(item_of(part, index) for part in value)
        return item_of(value, index) if isinstance(value, DepthPrior) else value

    return replace(batch, **{f.name: pick(getattr(batch, f.name)) for f in fields(batch)})


def outputs(prediction: Prediction) -> Iterator[Tensor]:
    """All that it says, side outputs last."""
    named = (prediction.depth, prediction.confidence, prediction.logits)
    yield from (value for value in named if value is not None)
    for stage in prediction.stages:
        yield from (stage.depth, stage.probability)
    if prediction.prior is not None:
        yield from (prediction.prior.log_median, prediction.prior.log_precision)
    for side in prediction.auxiliary:
        yield from outputs(side)


def assert_same(actual: Prediction, expected: Prediction) -> None:
    """But for the rounding of sums that are added up in another order."""
    for one, two in zip(outputs(actual), outputs(expected), strict=True):
        scale = two.abs().max().clamp(min=1)
        assert one.shape == two.shape and (one - two).abs().max() < 1e-3 * scale


@pytest.fixture(scope="module", params=MODELS)
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def model(name: str) -> Model:
    model = small(name)
    shuffle_statistics(model)
    return model.eval()


@pytest.fixture(scope="module")
def predicted(name: str, model: Model) -> Prediction:
    with torch.no_grad():
        return model(views_for(name))


def test_the_tasks_of_the_entry_are_predicted_in_finite_numbers_of_the_photo_s_size(
    name: str, predicted: Prediction
):
    tasks = MODELS[name].tasks
    assert (predicted.depth is not None) == ("depth" in tasks)
    assert (predicted.logits is not None) == ("semantics" in tasks)
    if predicted.depth is not None:
        assert predicted.depth.shape == (2, HEIGHT, WIDTH)
    if predicted.logits is not None:
        assert predicted.logits.shape == (2, 20, HEIGHT, WIDTH)
    assert all(value.isfinite().all() for value in outputs(predicted))


def test_items_of_a_batch_do_not_see_each_other(name: str, model: Model, predicted: Prediction):
    for index in range(2):
        with torch.no_grad():
            alone = model(item_of(views_for(name), index))
        assert_same(alone, item_of(predicted, index))


def test_its_state_makes_another_model_the_same(name: str, model: Model, predicted: Prediction):
    other = small(name, seed=1).eval()
    other.load_state_dict(model.state_dict())
    with torch.no_grad():
        again = other(views_for(name))
    for one, two in zip(outputs(again), outputs(predicted), strict=True):
        assert torch.equal(one, two)


def test_folding_its_batch_norms_changes_nothing(name: str, model: Model, predicted: Prediction):
    with torch.no_grad():
        assert_same(fold_batch_norm(model)(views_for(name)), predicted)


def test_every_trainable_parameter_gets_a_gradient_and_no_frozen_one(name: str, model: Model):
    model = deepcopy(model).train()
    for module in model.modules():
        if isinstance(module, StochasticDepth):
            module.p = 0.0  # a block left out for both items would learn nothing
    values = [value for value in outputs(model(views_for(name))) if value.requires_grad]
    torch.stack([(value * torch.randn_like(value)).sum() for value in values]).sum().backward()
    for parameter_name, parameter in model.named_parameters():
        gradient = parameter.grad
        if not parameter.requires_grad:
            assert gradient is None, parameter_name
        elif parameter_name not in WITHOUT_GRADIENT:
            assert gradient is not None and gradient.isfinite().all(), parameter_name
            assert gradient.ne(0).any(), parameter_name
