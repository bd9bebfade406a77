"""The context network: what it is told of a sweep, and what it makes of it."""

from dataclasses import replace

import pytest
import torch

from mvsam.mvs import context
from mvsam.mvs.context import ContextNetwork, quantiles
from mvsam.mvs.hypotheses import plane_depths
from mvsam.mvs.textbook import TextbookCascade
from mvsam.types import DepthPrior, Views
from tests.small import random_views, small_model

SIDE = 64
CELLS = SIDE // 4


@pytest.fixture
def views() -> Views:
    return random_views(num_views=3, height=SIDE, width=SIDE)


@pytest.fixture
def network() -> ContextNetwork:
    torch.manual_seed(0)
    return ContextNetwork(8, 6).eval()


def planes(count: int, far: float = 5.0) -> torch.Tensor:
    depths = plane_depths(torch.tensor([[0.1, far]]), count)
    return depths[:, :, None, None].expand(-1, -1, CELLS, CELLS)


def around(metres: float, hypotheses: torch.Tensor) -> torch.Tensor:
    """Scores of a normal distribution of 20 cm."""
    return -((hypotheses - metres) / 0.2).square() / 2


def prior() -> DepthPrior:
    return DepthPrior(torch.full((1, CELLS, CELLS), 0.5), torch.ones(1, CELLS, CELLS))


def seen() -> tuple[torch.Tensor, torch.Tensor]:
    torch.manual_seed(1)
    return torch.rand(1, 8, CELLS, CELLS), torch.rand(1, 6, CELLS, CELLS)


@pytest.mark.parametrize("count", [48, 96])
def test_quantiles_equal_the_slow_twin(count: int):
    hypotheses = planes(count)
    probability = torch.softmax(3 * torch.randn(hypotheses.shape), dim=1)
    found = quantiles(probability, hypotheses)[0, :, 3, 5]
    masses, depths = probability[0, :, 3, 5].tolist(), hypotheses[0, :, 3, 5].tolist()
    interval = depths[1] - depths[0]
    for share, metres in zip((0.03, 0.1, 0.25, 0.5, 0.75, 0.9, 0.97), found.tolist(), strict=True):
        below = 0.0
        for depth, mass in zip(depths, masses, strict=True):
            if below + mass >= share:
                expected = depth + interval * ((share - below) / mass - 0.5)
                break
            below += mass
        assert metres == pytest.approx(expected, abs=1e-3)


def test_it_begins_by_leaving_depth_nearly_as_it_is(network, views):
    hypotheses = planes(48)
    scores = around(2.0, hypotheses)
    with torch.no_grad():
        after = network(scores, hypotheses, *seen(), prior(), views).softmax(dim=1)
    depth = (after * hypotheses).sum(dim=1)
    torch.testing.assert_close(depth, torch.full_like(depth, 2.0), atol=0.02, rtol=0)


def test_where_it_trusts_nothing_depth_is_what_it_expects(network, views):
    """A shift of 0.5 of the logarithm: 1.65 times the sweep's median."""
    network.out.bias.data.copy_(torch.tensor([0.5, 3.0, -3.0, 5.0]))
    hypotheses = planes(192)
    with torch.no_grad():
        after = network(around(2.0, hypotheses), hypotheses, *seen(), prior(), views)
    best = hypotheses.gather(1, after.argmax(dim=1, keepdim=True))
    torch.testing.assert_close(best, torch.full_like(best, 2.0 * 1.6487), atol=0.05, rtol=0)


def test_other_ranges_and_twice_the_planes_change_depth_little(network, views):
    network.out.weight.data.normal_(0, 0.3)
    network.out.bias.data[3] = 2.0
    depths = []
    for count, far in ((48, 5.0), (96, 5.0), (96, 9.9)):
        hypotheses = planes(count, far)
        other = replace(views, depth_range=hypotheses[:, [0, -1], 0, 0])
        scores = around(2.0, hypotheses)
        with torch.no_grad():
            after = network(scores, hypotheses, *seen(), prior(), other).softmax(dim=1)
        depths.append((after * hypotheses).sum(dim=1))
    for depth in depths[1:]:
        torch.testing.assert_close(depth, depths[0], atol=0.04, rtol=0.02)
    assert depths[0].std() > 0.01, "it does something, and not the same everywhere"


def test_it_is_told_who_sees_a_place_and_how_well(views):
    """Two cameras beside the reference: one 20 cm to the right, one that looks the other way."""
    poses = torch.eye(4).repeat(1, 3, 1, 1)
    poses[0, 1, 0, 3] = 0.2
    poses[0, 2, :3, :3] = torch.diag(torch.tensor([-1.0, 1.0, -1.0]))
    looking = replace(views, world_from_cam=poses)
    log_quantiles = torch.full((1, 7, CELLS, CELLS), 2.0).log()
    near, middle, far, told = context._of_sources(log_quantiles, looking)
    focal = 0.9 * CELLS
    disparity = focal * 0.2 / 2.0  # 1.4 cells: the first column lies outside the source, or both
    columns = (torch.arange(CELLS) + 0.5 >= disparity).float() / 2
    for count in (near, middle, far):
        torch.testing.assert_close(count[0], columns.expand(CELLS, -1))
    moved = torch.where(columns > 0, disparity * (1 - 1 / 1.05), torch.zeros(()))
    torch.testing.assert_close(
        told[0], ((moved + 0.05).log() / 2 + 0.5).expand(CELLS, -1), atol=1e-4, rtol=1e-3
    )


def test_gradients_reach_it_and_the_sweep(network, views):
    network.out.weight.data.normal_(0, 0.1)
    hypotheses = planes(48)
    scores = around(2.0, hypotheses).clone().requires_grad_()
    after = network(scores, hypotheses, *seen(), prior(), views)
    (after.softmax(dim=1) * hypotheses).sum().backward()
    assert scores.grad is not None and scores.grad.abs().max() > 0
    assert all(p.grad is not None and p.grad.abs().max() > 0 for p in network.parameters())


def test_gradients_of_two_peaks_far_apart_have_a_bound(network, views):
    """Those of a quantile between them have none."""
    network.out.weight.data.normal_(0, 0.1)
    hypotheses = planes(48)
    scores = torch.full_like(hypotheses, -16.0)
    scores[:, [10, 30]] = 0.0
    scores.requires_grad_()
    after = network(scores, hypotheses, *seen(), prior(), views).softmax(dim=1)
    (after * hypotheses).sum(dim=1).mean().backward()
    assert scores.grad is not None and scores.grad.abs().max() * CELLS**2 < 10


def test_autocast_rounds_no_place(network, views):
    network.out.weight.data.normal_(0, 0.1)
    hypotheses = planes(48)
    scores, depths = around(2.0, hypotheses), []
    for is_cast in (False, True):
        with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=is_cast):
            after = network(scores, hypotheses, *seen(), prior(), views).softmax(dim=1)
        assert after.dtype == torch.float32
        depths.append((after * hypotheses).sum(dim=1))
    torch.testing.assert_close(depths[1], depths[0], atol=0.01, rtol=0)


def test_more_sources_than_it_ever_saw_count_as_those_it_saw():
    many = random_views(num_views=8, height=SIDE, width=SIDE)
    poses = torch.eye(4).repeat(1, 8, 1, 1)
    many = replace(many, world_from_cam=poses)
    told = context._of_sources(torch.full((1, 7, CELLS, CELLS), 2.0).log(), many)
    assert all(count.eq(2).all() for count in told[:3])


def test_the_textbook_cascade_asks_it_too():
    model, views = small_model("tiny").eval(), random_views(num_views=3, height=SIDE, width=SIDE)
    assert model.cascade is not None and model.context is not None
    assert model.context.out.bias is not None
    model.context.out.bias.data.copy_(torch.tensor([0.3, 0.0, -1.0, 1.0]))
    with torch.inference_mode():
        ours = model(views).stages[0]
        model.cascade = TextbookCascade(model.cascade)  # pyright: ignore
        plain = model(views).stages[0]
        model.context = None
        without = model(views).stages[0]
    torch.testing.assert_close(ours.probability, plain.probability, atol=2e-3, rtol=0)
    assert not torch.allclose(ours.probability, without.probability, atol=1e-2)
