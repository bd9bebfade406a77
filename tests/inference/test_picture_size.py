from dataclasses import replace

import numpy as np
import pytest

from mvsam.errors import InputError
from mvsam.inference.picture_size import picture_size
from mvsam.types import Frame
from tests.inference.fake_model import FakeModel


def frame(size: tuple[int, int]) -> Frame:
    return Frame("photo", size, np.eye(3), np.eye(4), load_image=lambda: np.zeros((1, 1, 3)))


def model(finer_sweeps: bool, input_size: tuple[int, int] = (320, 256)) -> FakeModel:
    fake = FakeModel()
    fake.input_size, fake.finer_sweeps = input_size, finer_sweeps
    return fake


@pytest.mark.parametrize(
    ("finer_sweeps", "photos", "expected"),
    [
        (True, [(640, 480), (480, 384)], (480, 384)),
        (True, [(640, 480), (479, 384)], (320, 256)),
        (True, [(320, 256)], (320, 256)),
        (False, [(640, 480)], (320, 256)),
    ],
)
def test_larger_photos_are_seen_half_as_large_again(finer_sweeps, photos, expected):
    assert picture_size(model(finer_sweeps), [frame(size) for size in photos]) == expected


def test_sides_stay_multiples_of_32():
    assert picture_size(model(True, (160, 128)), [frame((640, 480))]) == (224, 192)


def test_the_size_asked_for_is_taken_and_must_fit_the_network():
    photos = [replace(frame((64, 64)), name="small")]
    assert picture_size(model(True), photos, (640, 512)) == (640, 512)
    with pytest.raises(InputError, match=r"size 640 500 .* multiples of 32"):
        picture_size(model(True), photos, (640, 500))
    with pytest.raises(InputError, match="multiples of 32"):
        picture_size(model(True), photos, (0, 256))
