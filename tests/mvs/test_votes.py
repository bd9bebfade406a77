import pytest
import torch

from mvsam.mvs.cost_volume import variance_volume
from mvsam.mvs.hypotheses import plane_depths
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.mvs.textbook import TextbookCascade
from mvsam.mvs.votes import joint_scores, voted_scores
from mvsam.types import Views
from tests.small import random_views, small_model

SIDE = 16


@pytest.fixture
def views() -> Views:
    return random_views(batch=2, num_views=4, height=SIDE, width=SIDE)


def sweep_of(views: Views) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
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


def test_one_source_is_asked_once(views):
    sweep, asked = sweep_of(views.select([0, 1])), []

    def counted(volume: torch.Tensor) -> torch.Tensor:
        asked.append(len(volume))
        return first_channel(volume)

    given = voted_scores(variance_volume, counted, *sweep)
    assert asked == [2], "the pair of each of the two samples"
    torch.testing.assert_close(given, first_channel(variance_volume(*sweep)))


def test_one_opinion_after_the_other_says_what_all_at_once_say(views):
    features, intrinsics, world_from_cam, planes = sweep_of(views)
    eight = torch.cat([planes, 1 + planes[:, -2:]], dim=1)  # as many as the network halves thrice
    sweep = (features, intrinsics, world_from_cam, eight)
    regularizer = CostRegularizer(8).eval()
    at_once = voted_scores(variance_volume, regularizer, *sweep).detach()
    with torch.no_grad():
        one_by_one = voted_scores(variance_volume, regularizer, *sweep)
        joint = joint_scores(variance_volume, regularizer, *sweep)
    torch.testing.assert_close(at_once, one_by_one, atol=1e-4, rtol=1e-4)
    assert (at_once - joint).abs().max() > 1e-2 * at_once.abs().max()


def test_each_opinion_hands_its_gradient_back(views):
    features, intrinsics, world_from_cam, planes = sweep = sweep_of(views)
    features.requires_grad_()
    voted_scores(variance_volume, first_channel, *sweep).sum().backward()
    given, features.grad = features.grad, None
    for group in ([0, 1, 2, 3], [0, 1], [0, 2], [0, 3]):
        parts = (features[:, group], intrinsics[:, group], world_from_cam[:, group], planes)
        (joint_scores(variance_volume, first_channel, *parts).sum() / 4).backward()
    torch.testing.assert_close(given, features.grad, atol=1e-4, rtol=1e-4)


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
    assert cascade is not None and cascade.first_scores is voted_scores
    first = cascade.regularizers[0]
    assert isinstance(first, CostRegularizer)
    first.score.weight.data *= 300  # untrained it finds all hypotheses alike
    with torch.inference_mode():
        pyramid = model.encode(views).pyramid
        ours = cascade(pyramid, views)[0]
        plain = TextbookCascade(cascade)(pyramid, views)[0]
        cascade.first_scores = joint_scores
        without = cascade(pyramid, views)[0]
    torch.testing.assert_close(ours.probability, plain.probability, atol=2e-3, rtol=0)
    assert not torch.allclose(ours.probability, without.probability, atol=2e-3)
