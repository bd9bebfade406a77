import pytest
import torch
from torch import nn

from mvsam.baselines.measured import fill_holes, jet, measured_depth
from mvsam.baselines.ssma import GatedConcatenation, GatedFusion, Ssma, depth_in_colors
from tests.baselines.counting import count
from tests.small import random_views


def test_parameters_are_those_of_two_encoders_three_fusions_and_a_decoder():
    with torch.device("meta"):
        model = Ssma(20)
    assert [count(encoder) for encoder in model.encoders.values()] == [25_562_918] * 2
    assert [count(fusion) for fusion in model.fusion] == [427_040, 17_360, 17_360]
    assert count(model) - count(model.decoder.auxiliary_heads) == 56_200_892


def test_a_shut_gate_lets_half_of_both_through():
    """A gate of zero weights is sigmoid(0)."""
    fusion = GatedFusion(2, 1, mix=nn.Identity())
    for parameter in fusion.parameters():
        nn.init.zeros_(parameter)
    color, depth = torch.rand(1, 2, 3, 3), torch.rand(1, 2, 3, 3)
    torch.testing.assert_close(fusion(color, depth), torch.cat([color, depth], dim=1) / 2)


def test_the_decoder_s_skip_is_weighted_by_channel_and_its_own_features_are_not():
    torch.manual_seed(0)
    join = GatedConcatenation().eval()
    x, skip = torch.rand(1, 256, 4, 6), torch.ones(1, 24, 4, 6)
    with torch.no_grad():
        joined = join(x, skip)
        gate = join.gate(x.mean((-2, -1), keepdim=True))
    assert torch.equal(joined[:, :256], x)
    torch.testing.assert_close(joined[:, 256:], gate.expand_as(skip))


def test_holes_take_the_mean_of_the_smallest_cell_that_knows_any():
    depth = torch.zeros(1, 1, 3, 5)
    depth[0, 0, 0, :2] = torch.tensor([1.0, 3.0])
    depth[0, 0, 2, 4] = 8.0
    assert fill_holes(depth)[0, 0].tolist() == [
        [1, 3, 2, 2, 8],
        [2, 2, 2, 2, 8],
        [2, 2, 2, 2, 8],
    ]
    assert fill_holes(torch.zeros(1, 1, 3, 5)).eq(0).all()


def test_depth_runs_from_blue_to_red_over_the_range():
    assert jet(torch.tensor([0.25, 0.5, 0.75]).view(1, 1, 1, 3))[0, :, 0].T.tolist() == [
        [0, 0.5, 1],
        [0.5, 1, 0.5],
        [1, 0.5, 0],
    ]
    views = random_views(num_views=1, measured=True)
    assert views.measured_depth is not None
    views.measured_depth[0, 0, :2] = torch.tensor([0.1, 5.0])
    assert depth_in_colors(views)[0, :, 0, :2].T.tolist() == [[0, 0, 0.5], [0.5, 0, 0]]


def test_views_without_measured_depth_are_refused():
    with pytest.raises(ValueError, match=r"set views\.measured_depth"):
        measured_depth(random_views())
