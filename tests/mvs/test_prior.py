"""The monocular prior: what it says, and how the first sweep heeds it."""

import math
from dataclasses import replace

import pytest
import torch

from mvsam.mvs.cascade import DepthCascade
from mvsam.mvs.hypotheses import plane_depths
from mvsam.mvs.prior import MonocularPrior, log_density
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.types import DepthPrior
from tests.small import random_views

SIDE = 64


def prior_at(metres: float, precision: float, side: int = SIDE // 4) -> DepthPrior:
    full = torch.full((1, side, side), metres), torch.full((1, side, side), precision)
    return DepthPrior(*(values.log() for values in full))


def planes(count: int) -> torch.Tensor:
    return plane_depths(torch.tensor([[0.1, 5.0]]), count)[:, :, None, None]


def weighed_by(prior: DepthPrior):
    """As a model does it that has no more than a prior."""
    return lambda scores, hypotheses: scores + log_density(prior, hypotheses)


def flat_cascade() -> DepthCascade:
    """Whose sweeps say nothing: every hypothesis scores alike."""
    cascade = DepthCascade([CostRegularizer(channels) for channels in (32, 16, 8)]).eval()
    for regularizer in cascade.regularizers:
        regularizer.score.weight.data.zero_()  # pyright: ignore
    return cascade


def pyramid() -> list[torch.Tensor]:
    levels = ((32, 4), (16, 2), (8, 1))
    return [torch.rand(1, 2, channels, SIDE // by, SIDE // by) for channels, by in levels]


@pytest.fixture
def views():
    return random_views(num_views=2, height=SIDE, width=SIDE)


@pytest.fixture
def network() -> MonocularPrior:
    torch.manual_seed(0)
    return MonocularPrior(8).eval()


@pytest.mark.parametrize("metres", [0.8, 1.7, 3.0])
@pytest.mark.parametrize("precision", [6.0, 20.0])
def test_it_is_a_density_whose_median_is_the_median(metres: float, precision: float):
    hypotheses = planes(5000)
    density = log_density(prior_at(metres, precision, 1), hypotheses).exp() * (4.9 / 4999)
    assert density.sum().item() == pytest.approx(1, abs=0.08)  # some of it lies beyond the range
    before = density[hypotheses < metres].sum()
    assert before.item() == pytest.approx(0.5, abs=0.025)  # outliers lie evenly


def test_density_equals_the_slow_twin():
    """Laplace's in the logarithm of depth, a twentieth of it spread over the range."""
    hypotheses, median, precision = planes(48), 1.5, 8.0
    density = log_density(prior_at(median, precision, 1), hypotheses).flatten()
    for metres, value in zip(hypotheses.flatten().tolist(), density.tolist(), strict=True):
        laplace = precision / 2 * math.exp(-precision * abs(math.log(metres / median))) / metres
        assert value == pytest.approx(math.log(0.95 * laplace + 0.05 / 4.9), abs=1e-4)


@pytest.mark.parametrize("metres", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("precision", [5.0, 20.0])
def test_where_the_sweep_is_silent_depth_is_the_prior_s(views, metres: float, precision: float):
    depth = flat_cascade()(pyramid(), views, weighed_by(prior_at(metres, precision)))[-1].depth
    torch.testing.assert_close(depth, torch.full_like(depth, metres), atol=0.12, rtol=0.05)


@pytest.mark.parametrize("metres", [0.5, 4.0, 20.0, 1e-4])
def test_a_sweep_that_is_sure_overrules_it(views, metres: float):
    cascade = flat_cascade()
    hypotheses = cascade.hypotheses(0, [], (SIDE // 4, SIDE // 4), views)
    sure = torch.where(torch.arange(48) == 20, 14.0, 0.0)[None, :, None, None]
    cascade.scores = lambda index, *sweep: (  # pyright: ignore
        sure.expand_as(hypotheses) if index == 0 else torch.zeros(sweep[-1].shape)
    )
    first = cascade(pyramid(), views, weighed_by(prior_at(metres, 50.0)))[0]
    torch.testing.assert_close(first.depth, hypotheses[:, 20], atol=0.05, rtol=0)


def test_twice_the_focal_length_is_twice_the_depth(network, views):
    features, zoomed = torch.rand(1, 8, 16, 16), views.intrinsics.clone()
    zoomed[:, :, :2, :2] *= 2
    with torch.no_grad():
        near = network(features, views)
        far = network(features, replace(views, intrinsics=zoomed))
    torch.testing.assert_close(far.log_median.exp(), 2 * near.log_median.exp())
    torch.testing.assert_close(far.log_precision, near.log_precision)


def test_cells_that_are_too_sure_can_still_unlearn_it(network, views):
    network.layers[-1].bias.data[1] = 30.0
    log_precision = network(torch.rand(1, 8, 16, 16), views).log_precision
    assert (log_precision <= 4).all()
    network.layers[-1].bias.data[1] = 6.0
    log_precision = network(torch.rand(1, 8, 16, 16), views).log_precision
    log_precision.sum().backward()
    assert network.layers[-1].bias.grad[1] > 10
