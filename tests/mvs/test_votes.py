import pytest
import torch

from mvsam.mvs.cost_volume import variance_volume
from mvsam.mvs.hypotheses import plane_depths
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.mvs.textbook import TextbookCascade
from mvsam.mvs.votes import voted_scores
from mvsam.types import Views
from tests.small import random_views, small_model

SIDE = 16


@pytest.fixture
def views() -> Views:
    return random_views(batch=2, num_views=4, height=SIDE, width=SIDE)


def sweep_of(views: Views) -> tuple[torch.Tensor, ...]:
    features = torch.randn(2, views.num_views, 8, SIDE, SIDE)
    planes = plane_depths(views.depth_range, 6)[:, :, None, None].expand(-1, -1, SIDE, SIDE)
    return features, views.intrinsics, views.world_from_cam, planes


def first_channel(volume: torch.Tensor) -> torch.Tensor:
    return volume[:, 0]


def test_scores_are_the_mean_over_all_views_together_and_each_source_alone(views):
    features, intrinsics, world_from_cam, planes = sweep_of(views)
    groups = [[0, 1, 2, 3], [0, 1], [0, 2], [0, 3]]
    opinions = [
        variance_volume(features[:, group], intrinsics[:, group], world_from_cam[:, group], planes)
        for group in groups
    ]
    expected = torch.stack(opinions).mean(dim=0)[:, 0]
    sweep = (features, intrinsics, world_from_cam, planes)
    for is_training in (True, False):
        with torch.set_grad_enabled(is_training):
            given = voted_scores(variance_volume, first_channel, *sweep)
        torch.testing.assert_close(given, expected, atol=1e-5, rtol=1e-5)
    assert not torch.allclose(given, opinions[0][:, 0], atol=1e-2)


def test_one_source_is_no_other_opinion(views):
    two = views.select([0, 1])
    sweep = sweep_of(two)
    alone = first_channel(variance_volume(*sweep))
    torch.testing.assert_close(voted_scores(variance_volume, first_channel, *sweep), alone)


def test_the_order_of_the_sources_does_not_matter(views):
    features, intrinsics, world_from_cam, planes = sweep_of_views = sweep_of(views)
    order = [0, 3, 1, 2]
    moved = (features[:, order], intrinsics[:, order], world_from_cam[:, order], planes)
    one = voted_scores(variance_volume, first_channel, *sweep_of_views)
    other = voted_scores(variance_volume, first_channel, *moved)
    torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-5)


def test_the_textbook_cascade_counts_the_same_votes():
    model, views = small_model("tiny").eval(), random_views(num_views=3, height=64, width=64)
    cascade = model.cascade
    assert cascade is not None and cascade.sources_vote
    first = cascade.regularizers[0]
    assert isinstance(first, CostRegularizer)
    first.score.weight.data *= 300  # untrained it finds all hypotheses alike
    with torch.inference_mode():
        pyramid = model.encode(views).pyramid
        ours = cascade(pyramid, views)[0]
        plain = TextbookCascade(cascade)(pyramid, views)[0]
        cascade.sources_vote = False
        without = cascade(pyramid, views)[0]
    torch.testing.assert_close(ours.probability, plain.probability, atol=2e-3, rtol=0)
    assert not torch.allclose(ours.probability, without.probability, atol=2e-3)
