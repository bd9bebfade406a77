"""What a camera makes of the light."""

from dataclasses import replace

import numpy as np
import pytest

from mvsam.rooms.dice import Dice
from mvsam.rooms.photo import Sensor, _sheared, _shifted, _soften

PLAIN = Sensor(
    cast=(1.0, 1.0, 1.0),
    vignette=0.0,
    noise=0.0,
    blotches=0.0,
    softness=0.0,
    sharpening=0.0,
    saturation=1.0,
    contrast=1.0,
    metering=0.0,
    shake=0.0,
    shear=0.0,
    quality=0,
)


def picture(height: int = 24, width: int = 32) -> np.ndarray:
    return np.random.default_rng(0).random((height, width, 3)).astype(np.float32)


def test_a_faultless_camera_keeps_the_order_of_brightness():
    light = np.tile(np.linspace(0.05, 0.9, 32, dtype=np.float32)[None, :, None], (24, 1, 3))
    image = PLAIN.develop(light, 1.0, Dice(1)).astype(int)
    assert image.shape == (24, 32, 3) and (np.diff(image[0, :, 0]) > 0).all()


def test_a_frame_is_the_same_for_the_same_dice_and_another_for_others():
    sensor, light = Sensor.draw(Dice(3)), picture()
    first, second = (sensor.develop(light, 1.0, Dice(5)) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert (sensor.develop(light, 1.0, Dice(6)) != first).any()


def test_metering_brings_dark_and_bright_frames_nearer_to_each_other():
    def distance(metering: float) -> float:
        sensor = replace(PLAIN, metering=metering)
        means = [sensor.develop(picture() * scale, 1.0, Dice(1)).mean() for scale in (0.4, 1.2)]
        return means[1] - means[0]

    assert distance(0.8) < 0.5 * distance(0.0)


def test_shifting_by_whole_pixels_moves_them_and_a_shear_leaves_the_middle_row():
    light = picture(25)
    moved = _shifted(light, 3.0, -2.0)
    np.testing.assert_allclose(moved[:-2, 3:], light[2:, :-3], atol=1e-6)
    sheared = _sheared(light, 4.0)
    np.testing.assert_allclose(sheared[12], light[12], atol=1e-6)
    np.testing.assert_allclose(sheared[0, :-2], light[0, 2:], atol=1e-5)
    np.testing.assert_allclose(sheared[-1, 2:], light[-1, :-2], atol=1e-5)


@pytest.mark.parametrize("blur", [lambda x: _soften(x, 0.2), lambda x: _shifted(x, 0.5, 0.5)])
def test_blur_keeps_flat_places_and_calms_others(blur):
    flat = np.full((8, 8, 3), 0.3, dtype=np.float32)
    np.testing.assert_allclose(blur(flat), flat, atol=1e-6)
    assert blur(picture()).std() < 0.8 * picture().std()


def test_noise_has_its_size_and_compression_stays_near():
    flat = np.full((64, 64, 3), 0.5, dtype=np.float32)
    noisy = replace(PLAIN, noise=1.0).develop(flat, 1.0, Dice(1)).astype(float)
    assert 0.5 < noisy.std() < 2.5
    kept = replace(PLAIN, quality=90).develop(picture(64, 64), 1.0, Dice(1)).astype(float)
    exact = PLAIN.develop(picture(64, 64), 1.0, Dice(1)).astype(float)
    assert (
        0 < np.abs(kept.mean(axis=2) - exact.mean(axis=2)).mean() < 12
    )  # colour is kept less well
