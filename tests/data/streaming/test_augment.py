"""Augmented views: cameras still fit the pictures."""

import numpy as np
import torch

from mvsam.data.streaming.augment import (
    as_if_estimated,
    jitter_colors,
    mirrored,
    random_part,
    with_pose_noise,
)
from mvsam.types import Frame


def project(points: np.ndarray, intrinsics: np.ndarray, world_from_cam: np.ndarray):
    """(pixels, depths) of world points."""
    local = (points - world_from_cam[:3, 3]) @ world_from_cam[:3, :3]
    pixels = local @ intrinsics.T
    return pixels[:, :2] / pixels[:, 2:], local[:, 2]


def make_frame(size=(6, 4)) -> Frame:
    width, height = size
    turn = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, (0.3, -0.2, 1.0)
    image = np.arange(width * height * 3, dtype=np.uint8).reshape(height, width, 3)
    return Frame(
        name="a",
        size=size,
        intrinsics=np.array([[5.0, 0.7, 2.2], [0, 5.5, 1.9], [0, 0, 1]]),
        world_from_cam=pose,
        load_image=lambda: image,
        load_depth=lambda: image[..., 0].astype(np.float32),
    )


def test_a_mirrored_camera_sees_the_mirrored_world_at_the_mirrored_place():
    frame = make_frame()
    other = mirrored(frame)
    points = np.random.default_rng(0).normal((0, 0, 6), 1, size=(20, 3))
    here, depth_here = project(points, frame.intrinsics, frame.world_from_cam)
    there, depth_there = project(points * (-1, 1, 1), other.intrinsics, other.world_from_cam)
    np.testing.assert_allclose(there[:, 0], frame.size[0] - here[:, 0])
    np.testing.assert_allclose(there[:, 1], here[:, 1])
    np.testing.assert_allclose(depth_there, depth_here)
    np.testing.assert_allclose(np.linalg.det(other.world_from_cam[:3, :3]), 1)


def test_mirrored_pixels_swap_left_and_right():
    frame = make_frame()
    other = mirrored(frame)
    np.testing.assert_array_equal(other.image[:, 0], frame.image[:, -1])
    assert other.depth is not None and frame.depth is not None
    np.testing.assert_array_equal(other.depth[:, 0], frame.depth[:, -1])
    assert other.labels is None


def test_mirroring_twice_is_the_frame_itself():
    frame = make_frame()
    again = mirrored(mirrored(frame))
    np.testing.assert_allclose(again.world_from_cam, frame.world_from_cam)
    np.testing.assert_allclose(again.intrinsics, frame.intrinsics)
    np.testing.assert_array_equal(again.image, frame.image)


def test_jitter_differs_between_views_and_repeats_with_its_dice():
    images = torch.rand(1, 3, 8, 8).expand(3, -1, -1, -1)
    first = jitter_colors(images, 0.2, np.random.default_rng(5))
    second = jitter_colors(images, 0.2, np.random.default_rng(5))
    torch.testing.assert_close(first, second, rtol=0, atol=0)
    assert (first[0] - first[1]).abs().mean() > 0.01
    assert first.min() >= 0 and first.max() <= 1


def test_no_jitter_changes_nothing():
    images = torch.rand(2, 3, 5, 5)
    torch.testing.assert_close(jitter_colors(images, 0.0, np.random.default_rng(0)), images)


def test_a_random_part_shows_the_same_points_under_its_own_camera():
    frame = make_frame((60, 40))
    points = np.random.default_rng(0).normal((0, 0, 6), 0.3, size=(20, 3))
    whole, _ = project(points, frame.intrinsics, frame.world_from_cam)
    for seed in range(10):
        part = random_part(frame, 0.5, np.random.default_rng(seed))
        assert 30 <= part.size[0] <= 60 and abs(part.size[0] * 40 - part.size[1] * 60) <= 60
        pixels, _ = project(points, part.intrinsics, part.world_from_cam)
        left, top = np.rint(whole[0] - pixels[0]).astype(int)
        np.testing.assert_allclose(whole - pixels, np.tile((left, top), (20, 1)), atol=1e-9)
        expected = frame.image[top : top + part.size[1], left : left + part.size[0]]
        np.testing.assert_array_equal(part.image, expected)
    assert random_part(frame, 1.0, np.random.default_rng(0)).size == frame.size


def test_pose_noise_has_its_size_and_leaves_the_pose_rigid():
    frame, dice = make_frame(), np.random.default_rng(0)
    noisy = [with_pose_noise(frame, 0.01, 0.5, dice).world_from_cam for _ in range(300)]
    errors = np.linalg.inv(frame.world_from_cam) @ np.stack(noisy)
    turns = np.degrees(np.arccos(np.clip((np.trace(errors, axis1=1, axis2=2) - 2) / 2, -1, 1)))
    # Root mean squares over 900 numbers; 3^0.5 axes.
    np.testing.assert_allclose(errors[:, :3, 3].std(), 0.01, rtol=0.1)
    np.testing.assert_allclose((turns**2).mean() ** 0.5, 0.5 * 3**0.5, rtol=0.1)
    np.testing.assert_allclose(noisy[0][:3, :3] @ noisy[0][:3, :3].T, np.eye(3), atol=1e-12)
    still = with_pose_noise(frame, 0.0, 0.0, dice)
    np.testing.assert_allclose(still.world_from_cam, frame.world_from_cam)


def test_depth_as_if_estimated_keeps_what_is_unknown_and_errs_by_its_spread():
    dice = np.random.default_rng(0)
    depth = torch.full((1, 64, 80), 2.0)
    depth[:, :10] = 0
    off = []
    for _ in range(30):
        estimated = as_if_estimated(depth, 0.1, dice)
        assert (estimated[:, :10] == 0).all() and (estimated[:, 10:] > 0).all()
        off.append((estimated[:, 10:] / 2).log().abs().mean())
    assert 0.04 < torch.stack(off).mean() < 0.12


def test_depth_beside_a_hole_is_not_drawn_to_zero():
    depth = torch.full((1, 64, 80), 2.0)
    depth[:, :, 37:] = 0
    estimated = as_if_estimated(depth, 0.0, np.random.default_rng(0))
    torch.testing.assert_close(estimated, depth)


def test_depth_estimated_without_errors_only_loses_its_edges():
    depth = torch.full((1, 64, 80), 1.0)
    depth[:, :, 40:] = 3.0
    estimated = as_if_estimated(depth, 0.0, np.random.default_rng(0))
    assert ((estimated > 1.05) & (estimated < 2.95)).any()
    torch.testing.assert_close(estimated[:, :, :12], depth[:, :, :12])
    torch.testing.assert_close(estimated[:, :, -12:], depth[:, :, -12:])
