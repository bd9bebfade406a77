"""Lenses are taken away: straight lines become straight again."""

import numpy as np
import pytest

from mvsam.data.readers.undistort import Distortion, undistort

INTRINSICS = np.array([[60.0, 0, 40], [0, 62.0, 30], [0, 0, 1]])
BROWN = Distortion("brown", (-0.25, 0.06), (0.002, -0.003))
FISHEYE = Distortion("fisheye", (0.05, -0.01))


def smooth_picture(places: np.ndarray) -> np.ndarray:
    """A value in 20..235 for each place of the plane z = 1."""
    x, y = places[..., 0], places[..., 1]
    return 127 + 60 * np.sin(5 * x + y) + 45 * np.cos(4 * y - 2 * x)


def rays_of(size=(80, 60)) -> np.ndarray:
    column, row = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    return np.stack([(column - 40) / 60, (row - 30) / 62], axis=-1)


def straightened(bent: np.ndarray, distortion: Distortion) -> np.ndarray:
    """The straight ray of each bent one, by fixed-point steps."""
    straight = bent.copy()
    for _ in range(200):
        straight = straight - 0.7 * (distortion.bend(straight) - bent)
    return straight


@pytest.mark.parametrize("distortion", [BROWN, FISHEYE], ids=["brown", "fisheye"])
def test_an_undistorted_picture_is_the_pinhole_s(distortion: Distortion):
    rays = rays_of()
    taken = smooth_picture(straightened(rays, distortion))  # what the lens put at each pixel
    photo = np.rint(taken).astype(np.uint8)[..., None].repeat(3, axis=2)
    result = undistort(photo, INTRINSICS, distortion)
    expected = smooth_picture(rays)
    inner = (slice(10, 50), slice(12, 68))
    assert np.abs(result[inner][..., 0] - expected[inner]).max() < 4
    assert np.abs(photo[inner][..., 0] - expected[inner]).max() > 10, "the lens bends visibly"


def test_opencv_s_formula_by_hand():
    """k1 = 0.1 at (0.3, 0.4): radial 1.025; p1 = 0.01 adds 2 p1 x y and p1 (r^2 + 2 y^2)."""
    bent = Distortion("brown", (0.1,), (0.01, 0.0)).bend(np.array([[0.3, 0.4]]))
    np.testing.assert_allclose(bent, [[0.3 * 1.025 + 0.0024, 0.4 * 1.025 + 0.01 * 0.57]])


def test_a_fisheye_without_coefficients_bends_by_the_angle():
    bent = Distortion("fisheye", (0.0,)).bend(np.array([[1.0, 0.0], [0.0, 0.0]]))
    np.testing.assert_allclose(bent, [[np.pi / 4, 0], [0, 0]])
    assert not Distortion("fisheye").is_none and Distortion("brown", (0.0,)).is_none


def test_maps_are_not_mixed_and_say_where_nothing_was_seen():
    labels = np.zeros((60, 80), np.uint8)
    labels[:, 40:] = 7
    result = undistort(labels, INTRINSICS, Distortion("brown", (0.6,)), outside=255)
    assert set(np.unique(result)) == {0, 7, 255}
    assert result[0, 0] == 255 and result[30, 10] == 0 and result[30, 70] == 7
