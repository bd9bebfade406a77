from dataclasses import replace

import numpy as np
import pytest
import torch

from mvsam.baselines.mvs2d import MVS2D, EpipolarAttention, Mvs2dLoss, warp_and_look
from mvsam.baselines.mvs2d_head import Upsampler, inverse_depths
from mvsam.types import Prediction, Targets, Views
from tests.baselines.counting import count
from tests.reference import plane_sweep
from tests.small import random_views

TWO_METRES = torch.full((1, 32), 2.0)


def same_pose(views: Views) -> Views:
    return replace(views, world_from_cam=torch.eye(4).expand_as(views.world_from_cam))


def facing_away(views: Views) -> Views:
    """Everything the reference sees lies behind the sources."""
    poses = torch.eye(4).repeat(1, views.num_views, 1, 1)
    poses[:, 1:] = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0]))
    return replace(views, world_from_cam=poses)


def test_each_part_has_the_released_number_of_parameters():
    with torch.device("meta"):
        model, multiscale = MVS2D(), MVS2D(attention_stages=(1, 2, 3))
    assert (count(model.source_branch), count(model.depth_branch)) == (683_072, 11_176_512)
    assert [count(a) for a in multiscale.attention] == [46_560, 183_232, 726_912]
    assert (count(model.decoder), count(model.decoder.unused)) == (1_111_040, 73_792)
    parts = (model.head.unet, model.head.regressor, model.head.upsampler)
    assert [count(part) for part in parts] == [349_824, 1_443_840, 42_001]


def test_depths_are_evenly_spaced_in_their_inverses_and_begin_far():
    depths = inverse_depths(0.3, 10.1, 32)
    assert (depths[0].item(), depths[-1].item()) == pytest.approx((10.1, 0.3))
    steps = (1 / depths).diff()
    torch.testing.assert_close(steps, steps[:1].expand(31), atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("moved, embedding", [(same_pose, 0), (facing_away, 1)])
def test_where_all_hypotheses_look_alike_attention_is_even(moved, embedding: int):
    attention, views = EpipolarAttention(8), moved(random_views(num_views=2))
    with torch.no_grad():
        query, key = torch.randn(1, 2, 4, 8), torch.randn(1, 2, 4, 8)
        hypotheses = 1 + torch.rand(1, 32, 1, 1).expand(-1, -1, 4, 8)
        answer = attention.ask(query, key, 1, views, hypotheses)
        expected = attention.depth_embedding.mean(0) * attention.visible_embedding[embedding]
    torch.testing.assert_close(answer, expected[:, None, None].expand_as(answer[0])[None])


def test_attention_equals_the_slow_twin():
    torch.manual_seed(0)
    attention, views = EpipolarAttention(8, num_depths=6), random_views(num_views=2)
    query, key = torch.randn(2, 1, 2, 4, 8).unbind(0)
    hypotheses = torch.tensor([6.0, 3.0, 2.0, 1.0, 0.6, 0.4])[None, :, None, None]
    hypotheses = hypotheses.expand(-1, -1, 4, 8)
    with torch.no_grad():
        answer = attention.ask(query, key, 1, views, hypotheses)[0]
    intrinsics = views.intrinsics[0].double().numpy() * [[[1 / 8], [1 / 8], [1]]]
    poses = views.world_from_cam[0].double().numpy()
    warped = plane_sweep.warped_volume(
        np.stack([key[0], key[0]]), intrinsics, poses, hypotheses[0].numpy(), source=1
    )
    depth, visible = (
        x.detach().numpy() for x in (attention.depth_embedding, attention.visible_embedding)
    )
    outside = 0
    for row in range(4):
        for column in range(8):
            scores = query[0, :, row, column].numpy() @ warped[:, :, row, column] / np.sqrt(2)
            weights = np.exp(scores) / np.exp(scores).sum()
            expected = np.zeros(2)
            for plane in range(6):
                pixel, metres = (column + 0.5, row + 0.5), hypotheses[0, plane, row, column]
                (u, v), z = plane_sweep.project(pixel, metres.item(), intrinsics, poses, 1)
                is_outside = int(not (z > 0 and 0 <= u <= 8 and 0 <= v <= 4))
                outside += is_outside
                expected += weights[plane] * depth[plane] * visible[is_outside]
            np.testing.assert_allclose(answer[:, row, column], expected, atol=1e-4)
    assert 0 < outside < 6 * 4 * 8


def test_what_lies_before_the_source_and_in_its_picture_is_visible():
    views, hypotheses = random_views(num_views=2), TWO_METRES[:, :, None, None].expand(-1, -1, 4, 8)
    features = torch.randn(1, 3, 4, 8)
    warped, is_visible = warp_and_look(features, 1, same_pose(views), hypotheses)
    assert is_visible.all()
    torch.testing.assert_close(warped[:, :, 0], features, atol=1e-4, rtol=1e-4)
    warped, is_visible = warp_and_look(features, 1, facing_away(views), hypotheses)
    assert not is_visible.any() and warped.eq(0).all()


@pytest.fixture(scope="module")
def model() -> MVS2D:
    torch.manual_seed(0)
    return MVS2D().eval()


def seen_by(views: Views, order: list[int]) -> Views:
    return replace(
        views,
        images=views.images[:, order],
        intrinsics=views.intrinsics[:, order],
        world_from_cam=views.world_from_cam[:, order],
    )


def test_seeing_a_source_twice_changes_nothing(model: MVS2D):
    views = random_views(num_views=2)
    with torch.no_grad():
        once, twice = model(views).depth, model(seen_by(views, [0, 1, 1])).depth
    assert once is not None and twice is not None
    torch.testing.assert_close(once, twice, atol=1e-4, rtol=1e-4)


def test_the_depth_depends_on_the_sources(model: MVS2D):
    views = random_views(num_views=3)
    with torch.no_grad():
        first, second = model(views).depth, model(seen_by(views, [0, 1])).depth
    assert first is not None and second is not None and not torch.allclose(first, second)


def test_a_single_view_is_refused(model: MVS2D):
    with pytest.raises(ValueError, match="needs a source view"):
        model(random_views(num_views=1))


def test_upsampling_adds_a_tenth_of_its_correction():
    upsampler, depth = Upsampler(), torch.rand(1, 1, 2, 3)
    with torch.no_grad():
        upsampler.at_full[2].weight.zero_()  # pyright: ignore
        upsampler.at_full[2].bias.fill_(0.5)  # pyright: ignore
        large = upsampler(depth, torch.randn(1, 256, 2, 3))
    expected = depth.repeat_interleave(4, -1).repeat_interleave(4, -2) + 0.05
    torch.testing.assert_close(large, expected)


def test_the_loss_is_the_mean_error_wherever_depth_is_known():
    targets = Targets(
        torch.tensor([[[1.0, 0.0], [9.0, 2.0]]]), torch.zeros(1, 2, 2, dtype=torch.long)
    )
    prediction = Prediction(torch.full((1, 2, 2), 3.0))
    loss = Mvs2dLoss()(prediction, targets, torch.tensor([[0.1, 5.0]]))["loss"]
    assert loss.item() == pytest.approx((2 + 6 + 1) / 3)
