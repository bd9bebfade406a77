"""The monocular prior: what it says, and how the first sweep heeds it."""

from dataclasses import replace

import torch

from mvsam.mvs.cascade import DepthCascade
from mvsam.mvs.prior import MonocularPrior, log_density
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.types import DepthPrior
from tests.small import random_views


def prior_at(metres: float, precision: float, size=(16, 16)) -> DepthPrior:
    return DepthPrior(torch.full((1, *size), metres).log(), torch.full((1, *size), precision))


def flat_cascade() -> DepthCascade:
    """Whose sweeps say nothing: every hypothesis scores alike."""
    cascade = DepthCascade([CostRegularizer(channels, base=2) for channels in (8, 4, 2)]).eval()
    for regularizer in cascade.regularizers:
        torch.nn.init.zeros_(regularizer.score.weight)
    return cascade


def pyramid(num_views: int, height: int, width: int) -> list[torch.Tensor]:
    return [
        torch.rand(1, num_views, channels, height // scale, width // scale)
        for channels, scale in ((8, 4), (4, 2), (2, 1))
    ]


def test_half_of_its_mass_lies_before_the_median():
    hypotheses = torch.linspace(-3, 3, 6001).exp()[None, :, None, None]  # even in the logarithm
    density = log_density(prior_at(1.7, 5.0, (1, 1)), hypotheses).softmax(dim=1)
    before = density[hypotheses < 1.7].sum()
    torch.testing.assert_close(before, torch.tensor(0.5), atol=1e-3, rtol=0)


def test_precision_is_one_over_the_mean_deviation():
    hypotheses = torch.linspace(-4, 4, 8001).exp()[None, :, None, None]
    density = log_density(prior_at(1.0, 5.0, (1, 1)), hypotheses).softmax(dim=1)
    deviation = (density * hypotheses.log().abs()).sum()
    torch.testing.assert_close(deviation, torch.tensor(1 / 5.0), atol=1e-3, rtol=0)


def test_where_the_sweep_is_silent_depth_is_the_prior_s():
    views = random_views(num_views=2, height=64, width=64)
    stages = flat_cascade()(pyramid(2, 64, 64), views, prior_at(2.0, 40.0))
    torch.testing.assert_close(stages[-1].depth, torch.full((1, 64, 64), 2.0), atol=0.1, rtol=0)


def test_a_sweep_that_is_sure_overrules_it():
    views, cascade = random_views(num_views=2, height=64, width=64), flat_cascade()
    hypotheses = cascade.hypotheses(0, [], (16, 16), views)
    sure = torch.where(torch.arange(48) == 10, 30.0, 0.0)[None, :, None, None]
    cascade.scores = lambda index, *sweep: (  # pyright: ignore
        sure.expand(1, 48, 16, 16) if index == 0 else torch.zeros(sweep[-1].shape)
    )
    stages = cascade(pyramid(2, 64, 64), views, prior_at(4.0, 5.0))
    torch.testing.assert_close(stages[0].depth, hypotheses[:, 10], atol=1e-2, rtol=0)


def test_at_first_it_decides_nothing():
    features, views = torch.rand(1, 8, 16, 16), random_views(num_views=2, height=64, width=64)
    with torch.no_grad():
        prior = MonocularPrior(8).eval()(features, views)
        given = pyramid(2, 64, 64)
        plain, weighed = (flat_cascade()(given, views, p)[0].probability for p in (None, prior))
    assert (plain / weighed).log().abs().max() < 0.5


def test_twice_the_focal_length_is_twice_the_depth():
    features, views = torch.rand(1, 8, 16, 16), random_views(num_views=2, height=64, width=64)
    prior = MonocularPrior(8).eval()
    zoomed = views.intrinsics.clone()
    zoomed[:, :, :2, :2] *= 2
    with torch.no_grad():
        near = prior(features, views)
        far = prior(features, replace(views, intrinsics=zoomed))
    torch.testing.assert_close(far.log_depth.exp(), 2 * near.log_depth.exp())
    torch.testing.assert_close(far.precision, near.precision)
