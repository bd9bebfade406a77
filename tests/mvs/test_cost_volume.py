import numpy as np
import pytest
import torch

from mvsam.mvs.cost_volume import textbook_variance_volume, variance_volume
from tests.reference import plane_sweep
from tests.small import random_poses, random_views


def problem(num_views=3, channels=8, planes=4, height=8, width=12, batch=1, seed=0):
    """Features, intrinsics, poses and hypotheses in float32."""
    views = random_views(batch, num_views, height, width, seed)
    generator = torch.Generator().manual_seed(seed)
    features = torch.randn(batch, num_views, channels, height, width, generator=generator)
    hypotheses = 0.3 + 4 * torch.rand(batch, planes, height, width, generator=generator)
    return features, views.intrinsics, views.world_from_cam, hypotheses


@pytest.mark.parametrize("volume", [variance_volume, textbook_variance_volume])
def test_eq_2_equals_the_slow_twin(volume):
    arguments = problem(num_views=3, channels=8, planes=3, height=6, width=8)
    expected = plane_sweep.variance_volume(*(x[0].double().numpy() for x in arguments))
    # Float32 coordinates are exact to 1e-5 pixels; features differ by a few units a pixel.
    np.testing.assert_allclose(volume(*arguments)[0], expected, atol=3e-4)


def test_variance_is_zero_for_identical_views():
    features, intrinsics, poses, hypotheses = problem(height=16, width=16)
    same = variance_volume(
        features[:, :1].expand_as(features),
        intrinsics,
        poses[:, :1].expand_as(poses),
        hypotheses,
    )
    # Reading at a coordinate that is 1e-5 pixels off, and squares that cancel in float32.
    assert same.abs().max() < 1e-5


def test_textbook_gradient_is_right_in_float64():
    features, intrinsics, poses, hypotheses = problem(channels=1, planes=2, height=4, width=5)
    features = features.double().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda x: textbook_variance_volume(x, intrinsics, poses, hypotheses.double()), features
    )


def test_views_behind_the_camera_and_outside_enter_as_zeros():
    features, intrinsics, poses, hypotheses = problem(num_views=2, height=8, width=8)
    poses = poses.clone()
    poses[:, 1] = poses[:, 0] @ torch.diag(torch.tensor([-1.0, 1, -1, 1]))  # looks backwards
    reference = features[:, 0, :, None].expand(-1, -1, hypotheses.shape[1], -1, -1)
    with_zeros = reference.square() / 2 - (reference / 2).square()
    torch.testing.assert_close(
        variance_volume(features, intrinsics, poses, hypotheses), with_zeros, atol=1e-6, rtol=1e-5
    )
    poses[:, 1] = poses[:, 0]
    poses[:, 1, :3, 3] += 1000.0  # far to the side
    torch.testing.assert_close(
        variance_volume(features, intrinsics, poses, hypotheses), with_zeros, atol=1e-6, rtol=1e-5
    )


@pytest.mark.parametrize("num_views", [3, 8])
def test_the_order_of_source_views_does_not_matter(num_views: int):
    features, intrinsics, poses, hypotheses = problem(num_views)
    order = [0, *range(num_views - 1, 0, -1)]
    torch.testing.assert_close(
        variance_volume(features[:, order], intrinsics[:, order], poses[:, order], hypotheses),
        variance_volume(features, intrinsics, poses, hypotheses),
    )


def test_moving_and_turning_the_world_frame_does_not_matter():
    features, intrinsics, poses, hypotheses = problem()
    move = random_poses(1, torch.Generator().manual_seed(9), angle=1.0)[0].double()
    move[:3, 3] = torch.tensor([3.0, -2.0, 5.0])
    torch.testing.assert_close(
        variance_volume(features, intrinsics, move @ poses.double(), hypotheses),
        variance_volume(features, intrinsics, poses, hypotheses),
        atol=1e-3,  # the rotations are orthogonal to float32 only, and the world is metres away
        rtol=0,
    )


def test_batch_items_are_independent():
    arguments = problem(batch=2)
    both = variance_volume(*arguments)
    for item in range(2):
        alone = variance_volume(*(x[item : item + 1] for x in arguments))
        assert torch.equal(both[item : item + 1], alone)
