import math

import numpy as np
import pytest
import torch

from mvsam.geometry.camera import scale_intrinsics
from mvsam.geometry.warp import (
    project_hypotheses,
    sample_bilinear,
    source_from_reference_pixels,
    warp_to_reference,
)
from tests import synthetic
from tests.reference import plane_sweep
from tests.small import random_views

INTRINSICS = torch.tensor([[290.0, 0, 160], [0, 290, 128], [0, 0, 1]])


def moved(x: float, y: float, z: float, yaw_deg: float = 0.0) -> torch.Tensor:
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    return torch.tensor(
        [[cos, 0, sin, x], [0, 1, 0, y], [-sin, 0, cos, z], [0, 0, 0, 1]], dtype=torch.float64
    )


def two_cameras(source: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    poses = torch.stack([torch.eye(4, dtype=torch.float64), source])[None]
    return INTRINSICS.double().expand(1, 2, 3, 3), poses


@pytest.mark.parametrize(
    "source, pixel, depth, expected",
    [
        (moved(0.1, 0, 0), (100, 50), 2.0, (85.5, 50.0, 2.0)),
        (
            moved(0.1, -0.05, 0.2, yaw_deg=10),
            (200, 100),
            1.5,
            (133.10133415, 106.82681247, 1.29881247),
        ),
    ],
    ids=["sideways", "turned"],
)
def test_eq_1_gives_the_published_coordinates(source, pixel, depth, expected):
    linear, offset = source_from_reference_pixels(*two_cameras(source), source=1)
    ray = torch.tensor([*pixel, 1.0], dtype=torch.float64)
    q = linear[0] @ ray * depth + offset[0]
    actual = (float(q[0] / q[2]), float(q[1] / q[2]), float(q[2]))
    assert actual == pytest.approx(expected, abs=1e-8)


def test_eq_1_projects_pixel_centres_of_the_corner_convention():
    # Shifting the calibration by half a pixel makes centre (100.5, 50.5) the vector's (100, 50).
    intrinsics, poses = two_cameras(moved(0.1, 0, 0))
    intrinsics = intrinsics + torch.tensor([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    linear, offset = source_from_reference_pixels(intrinsics, poses, source=1)
    coordinates, in_front = project_hypotheses(linear, offset, torch.full((1, 1, 60, 120), 2.0))
    assert coordinates[0, 0, 50, 100].tolist() == pytest.approx([86.0, 50.5], abs=1e-4)
    assert in_front.all()


def test_projection_equals_the_slow_twin_for_any_reference():
    views = random_views(num_views=3, height=6, width=8, seed=3)
    depths = 0.3 + 3 * torch.rand(1, 2, 6, 8)
    intrinsics, poses = views.intrinsics[0].double().numpy(), views.world_from_cam[0].numpy()
    linear, offset = source_from_reference_pixels(
        views.intrinsics, views.world_from_cam, source=0, reference=2
    )
    coordinates, in_front = project_hypotheses(linear, offset, depths)
    for plane, row, column in np.ndindex(2, 6, 8):
        expected, z = plane_sweep.project(
            (column + 0.5, row + 0.5),
            float(depths[0, plane, row, column]),
            intrinsics,
            poses,
            source=0,
            reference=2,
        )
        # Float32 rounds a coordinate of some ten pixels by about a millionth of it.
        np.testing.assert_allclose(coordinates[0, plane, row, column], expected, atol=1e-3)
        assert bool(in_front[0, plane, row, column]) == (z > 1e-6)


def test_warp_equals_the_slow_twin():
    views = random_views(num_views=2, height=6, width=8, seed=4)
    features = torch.randn(2, 3, 6, 8)
    depths = 0.3 + 3 * torch.rand(1, 2, 6, 8)
    linear, offset = source_from_reference_pixels(views.intrinsics, views.world_from_cam, source=1)
    warped = warp_to_reference(features[1:], linear, offset, depths)
    expected = plane_sweep.warped_volume(
        features.double().numpy(),
        views.intrinsics[0].double().numpy(),
        views.world_from_cam[0].double().numpy(),
        depths[0].double().numpy(),
        source=1,
    )
    np.testing.assert_allclose(warped[0], expected, atol=1e-4)


def test_scaled_intrinsics_give_the_scaled_projection():
    views = random_views(num_views=2, height=16, width=16, seed=6)
    half = scale_intrinsics(views.intrinsics, 0.5, 0.5)
    full_linear, full_offset = source_from_reference_pixels(
        views.intrinsics, views.world_from_cam, source=1
    )
    half_linear, half_offset = source_from_reference_pixels(half, views.world_from_cam, source=1)
    pixel = torch.tensor([6.0, 10.0, 1.0], dtype=torch.float64)
    half_pixel = torch.tensor([3.0, 5.0, 1.0], dtype=torch.float64)
    full = full_linear[0] @ pixel * 1.5 + full_offset[0]
    small = half_linear[0] @ half_pixel * 1.5 + half_offset[0]
    torch.testing.assert_close(small[:2] / small[2], full[:2] / full[2] / 2)


@pytest.mark.parametrize("depth", [0.1, 1.0, 5.0, 1000.0])
def test_identity_warp_returns_the_source_at_any_depth(depth: float):
    features = torch.randn(1, 4, 24, 32)
    pose = random_views(num_views=1, seed=5).world_from_cam[:, [0, 0]]
    intrinsics = random_views(num_views=2, height=24, width=32).intrinsics
    linear, offset = source_from_reference_pixels(intrinsics, pose, source=1)
    warped = warp_to_reference(features, linear, offset, torch.full((1, 1, 24, 32), depth))
    # Coordinates of up to 32 pixels are exact to about 1e-5 in float32.
    torch.testing.assert_close(warped[:, :, 0], features, atol=1e-4, rtol=0)


def test_points_behind_the_source_camera_read_zero():
    intrinsics, poses = two_cameras(moved(0, 0, 0, yaw_deg=180))
    linear, offset = source_from_reference_pixels(intrinsics, poses, source=1)
    depths = torch.full((1, 2, 8, 8), 2.0)
    _, in_front = project_hypotheses(linear, offset, depths)
    assert not in_front.any()
    assert warp_to_reference(torch.ones(1, 3, 8, 8), linear, offset, depths).eq(0).all()


def test_a_point_in_the_plane_of_the_source_camera_is_out_of_view_and_finite():
    intrinsics, poses = two_cameras(moved(0, 0, 2.0))
    linear, offset = source_from_reference_pixels(intrinsics, poses, source=1)
    coordinates, in_front = project_hypotheses(linear, offset, torch.full((1, 1, 4, 4), 2.0))
    assert coordinates.isfinite().all() and not in_front.any()


def test_samples_outside_the_view_read_zero_and_fade_at_its_border():
    image = torch.ones(1, 1, 4, 4)
    u = torch.tensor([-1.0, -0.5, 0.0, 0.5, 2.0, 4.0, 4.5, 9.0])
    coordinates = torch.stack([u, torch.full_like(u, 2.0)], dim=-1)[None, None, None]
    in_front = torch.ones(1, 1, 1, 8, dtype=torch.bool)
    values = sample_bilinear(image, coordinates, in_front).flatten()
    assert values.tolist() == [0, 0, 0.5, 1, 1, 0.5, 0, 0]


def test_warping_at_the_true_depth_reproduces_the_reference_picture():
    truth = synthetic.synthetic_views(num_frames=2, size=(96, 64), baseline=0.05)
    images = [torch.from_numpy(view.image).permute(2, 0, 1) / 255 for view in truth]
    intrinsics = torch.from_numpy(np.stack([view.intrinsics for view in truth]))[None]
    poses = torch.from_numpy(np.stack([view.world_from_cam for view in truth]))[None]
    linear, offset = source_from_reference_pixels(intrinsics, poses, source=1)
    depth = torch.from_numpy(truth[0].depth)[None, None]
    warped = warp_to_reference(images[1][None], linear, offset, depth)[0, :, 0]
    visible = warped.sum(0) > 0.5
    error = (warped - images[0]).abs().mean(0)[visible]
    assert visible.float().mean() > 0.8
    # 8-bit photos and bilinear reading of a smooth texture: about half a grey level of 255.
    assert error.median() < 0.005
    wrong = warp_to_reference(images[1][None], linear, offset, depth * 1.2)[0, :, 0]
    assert (wrong - images[0]).abs().mean(0)[visible].median() > 5 * error.median()


def test_no_gradient_goes_through_the_sampling_positions():
    views = random_views(num_views=2, height=8, width=8)
    linear, offset = source_from_reference_pixels(views.intrinsics, views.world_from_cam, source=1)
    depths = torch.ones(1, 2, 8, 8, requires_grad=True)
    features = torch.randn(1, 2, 8, 8, requires_grad=True)
    warp_to_reference(features, linear, offset, depths).sum().backward()
    assert depths.grad is None and features.grad is not None
