import pytest
import torch
from torch import nn

from mvsam.baselines.mt_refinenet import (
    ChainedPooling,
    MtRefineNet,
    MtRefineNetLoss,
    reverse_huber,
)
from mvsam.types import Prediction, Targets
from tests.baselines.counting import count
from tests.small import random_targets, random_views


def test_parameters_are_those_of_the_release():
    with torch.device("meta"):
        model, more = MtRefineNet(20), MtRefineNet(40)
    assert count(model) == 3_023_957 and count(more) == 3_070_057
    assert [count(p) for p in model.projection] == [6_144, 8_192, 16_384, 24_576, 40_960, 81_920]
    assert [count(p) for p in model.pooling] == [1_024, 262_144, 262_144, 262_144]
    assert {t: count(h) for t, h in model.head.items()} == {"semantics": 46_356, "depth": 2_561}


def test_chained_pooling_spreads_a_maximum_by_two_pixels_a_stage():
    pooling = ChainedPooling()
    for convolution in pooling.convolutions:
        nn.init.dirac_(next(convolution.parameters()))
    x = torch.zeros(1, 256, 1, 21)
    x[..., 10] = 1.0
    expected = [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 4, 4, 3, 3, 2, 2, 1, 1, 0, 0]
    assert pooling(x)[0, 7, 0].tolist() == expected


def test_reverse_huber_turns_quadratic_at_a_fifth_of_the_largest_error():
    error = torch.tensor([0.0, 1.0, -5.0, 100.0])
    mask = torch.tensor([True, True, True, False])
    assert reverse_huber(error, mask)[:3].tolist() == pytest.approx([0.0, 1.0, 13.0])


def test_reverse_huber_of_a_perfect_depth_is_zero_with_a_finite_gradient():
    error = torch.zeros(3, requires_grad=True)
    loss = reverse_huber(error, torch.ones(3, dtype=torch.bool)).sum()
    loss.backward()
    assert loss.item() == 0 and error.grad is not None and error.grad.isfinite().all()


def test_loss_is_half_cross_entropy_and_half_reverse_huber():
    depth = torch.tensor([[[2.0, 3.0, 7.0]]])
    targets = Targets(torch.tensor([[[2.0, 2.0, 2.0]]]), torch.zeros(1, 1, 3, dtype=torch.long))
    prediction = Prediction(depth=depth, logits=torch.zeros(1, 2, 1, 3))
    parts = MtRefineNetLoss()(prediction, targets, torch.tensor([[0.1, 5.0]]))
    assert parts["depth"].item() == pytest.approx(14 / 3)
    assert parts["segmentation"].item() == pytest.approx(0.693147, abs=1e-5)
    assert parts["loss"].item() == pytest.approx(7 / 3 + 0.346574, abs=1e-5)


def test_depth_is_never_negative():
    model = MtRefineNet(2).eval()
    *_, bias = model.head["depth"].parameters()
    nn.init.constant_(bias, -1.0)
    with torch.no_grad():
        depth = model(random_views(num_views=1)).depth
    assert depth is not None and depth.eq(0).all()


@pytest.mark.parametrize("seed", range(3))
def test_depth_learns_from_the_first_step_on(seed: int):
    torch.manual_seed(seed)
    model, views = MtRefineNet(20), random_views(batch=2, num_views=1)
    MtRefineNetLoss()(model(views), random_targets(2), views.depth_range)["depth"].backward()
    *_, bias = model.head["depth"].parameters()
    assert bias.grad is not None and bias.grad.abs() > 0.01


def test_the_encoder_learns_at_a_tenth_of_the_decoder_s_rate():
    model = MtRefineNet(20)
    encoder, decoder = model.parameter_groups(1e-3)
    assert encoder["lr"] == 1e-3 and decoder["lr"] == pytest.approx(1e-2)
    assert sum(p.numel() for p in encoder["params"]) == 1_812_800
    assert sum(p.numel() for p in decoder["params"]) == 3_023_957 - 1_812_800
