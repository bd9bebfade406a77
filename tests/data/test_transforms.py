import numpy as np
import pytest

from mvsam.data.transforms import (
    area_resize,
    crop_to_shape,
    resize_intrinsics,
    resize_nearest,
)
from mvsam.types import Frame
from tests.reference.resize import area_average, nearest
from tests.synthetic import camera_intrinsics, camera_pose, render

rng = np.random.default_rng(0)


@pytest.mark.parametrize("size", [(8, 6), (7, 5), (16, 3), (16, 12)])
def test_shrinking_averages_the_covered_area(size):
    image = rng.integers(0, 256, (12, 16, 3), dtype=np.uint8)
    expected = area_average(image, size) / 255
    result = area_resize(image, size).permute(1, 2, 0).numpy()
    np.testing.assert_allclose(result, expected, atol=1e-6)  # float32


def test_an_image_of_the_right_size_is_unchanged():
    image = rng.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    result = (area_resize(image, (8, 6)) * 255).round().byte()
    np.testing.assert_array_equal(result.permute(1, 2, 0).numpy(), image)


def test_a_ramp_keeps_its_place_in_any_size():
    """Corner convention: colour depends on position in [0, W], whatever the number of pixels."""
    ramp = (8 * np.arange(30) + 4).astype(np.uint8)  # 8 grey values a pixel, centres at halves
    image = np.repeat(np.repeat(ramp[None, :, None], 4, axis=0), 3, axis=2)
    for width in (10, 15, 60, 90):
        centres = (np.arange(width) + 0.5) * 30 / width
        inner = (centres > 1) & (centres < 29)  # bilinear growth clamps at the border
        result = area_resize(image, (width, 4))[0, 0].numpy() * 255
        np.testing.assert_allclose(result[inner], 8 * centres[inner], atol=0.51)


@pytest.mark.parametrize("size", [(5, 3), (6, 6), (12, 9), (20, 31)])
def test_nearest_takes_the_pixel_whose_centre_is_nearest(size):
    values = rng.integers(0, 20, (9, 12)).astype(np.uint8)
    np.testing.assert_array_equal(resize_nearest(values, size), nearest(values, size))


def test_nearest_never_mixes_depths():
    depth = rng.choice(np.array([0.0, 1.5, 4.0], np.float32), (48, 64))
    resized = resize_nearest(depth, (32, 25))
    assert resized.dtype == np.float32
    assert set(np.unique(resized)) <= {0.0, 1.5, 4.0}


def test_resize_then_project_equals_project_then_resize():
    intrinsics = camera_intrinsics((64, 48))
    points = rng.uniform([-1, -1, 1], [1, 1, 3], (50, 3))
    small = resize_intrinsics(intrinsics, (64, 48), (20, 36))
    pixels, small_pixels = points @ intrinsics.T, points @ small.T
    np.testing.assert_allclose(
        small_pixels[:, :2] / small_pixels[:, 2:],
        pixels[:, :2] / pixels[:, 2:] * [20 / 64, 36 / 48],
        rtol=1e-12,
    )


def test_a_resized_photo_is_what_the_resized_camera_sees():
    """Shrinking picture, depth and intrinsics together agrees with rendering at the small size."""
    big, small = (160, 120), (53, 40)
    intrinsics, pose = camera_intrinsics(big), camera_pose(1)
    image, depth, _ = render(big, intrinsics, pose)
    expected, expected_depth, _ = render(small, resize_intrinsics(intrinsics, big, small), pose)
    difference = area_resize(image, small).permute(1, 2, 0).numpy() * 255 - expected
    # Half a small pixel of shift costs 15 grey values on this texture, blur about 2.
    assert np.abs(difference).mean() < 4
    # Half a small pixel of shift costs 0.7 % of depth.
    error = np.abs(resize_nearest(depth, small) - expected_depth) / expected_depth
    assert error.mean() < 0.002


def test_a_crop_is_the_largest_central_part_of_the_wanted_shape():
    pixels = np.arange(480)[:, None] + np.arange(640)[None] / 1000
    frame = Frame(
        name="0",
        size=(640, 480),
        intrinsics=np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]),
        world_from_cam=np.eye(4),
        load_image=lambda: np.zeros((480, 640, 3), np.uint8),
        load_depth=lambda: pixels,
    )
    wide = crop_to_shape(frame, (320, 256))  # 5:4 of 480 rows are 600 columns
    assert wide.size == (600, 480) and wide.image.shape == (480, 600, 3) and wide.labels is None
    np.testing.assert_array_equal(wide.depth, pixels[:, 20:620])
    assert wide.intrinsics.tolist() == [[500, 0, 300], [0, 500, 240], [0, 0, 1]]
    high = crop_to_shape(frame, (320, 160))
    assert high.size == (640, 320) and high.intrinsics[1, 2] == 160
    np.testing.assert_array_equal(high.depth, pixels[80:400])
