"""Pixels to points and back."""

import numpy as np

from mvsam.geometry.points import moved, to_pixels, viewing_rays

INTRINSICS = np.array([[300.0, 0.5, 160.0], [0, 280.0, 120.0], [0, 0, 1]])


def test_points_on_a_ray_return_to_its_pixel():
    columns, rows = np.meshgrid(np.arange(5), np.arange(3))
    rays = viewing_rays(columns, rows, INTRINSICS)
    assert rays.shape == (3, 5, 3) and (rays[..., 2] == 1).all()
    pixels, depth = to_pixels(2.5 * rays, INTRINSICS)
    np.testing.assert_allclose(pixels, np.stack([columns + 0.5, rows + 0.5], axis=-1))
    np.testing.assert_allclose(depth, 2.5)


def test_the_principal_point_lies_straight_ahead():
    np.testing.assert_allclose(
        viewing_rays(np.array([159.5]), np.array([119.5]), INTRINSICS), [[0, 0, 1]], atol=1e-12
    )


def test_what_is_behind_the_camera_has_no_pixel():
    pixels, depth = to_pixels(np.array([[0.0, 0, -1], [1, 1, 0], [0, 0, 1]]), INTRINSICS)
    assert np.isinf(pixels[:2]).all() and np.isfinite(pixels[2]).all()
    assert depth.tolist() == [-1, 0, 1]


def test_moving_turns_first_and_shifts_then():
    quarter = np.array([[0.0, -1, 0, 5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(moved(np.array([[1.0, 0, 2]]), quarter), [[5, 1, 2]])
