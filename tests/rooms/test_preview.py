"""Contact sheets of rooms."""

import numpy as np
import pytest

from mvsam import rooms


@pytest.fixture(scope="module")
def scene() -> rooms.RoomScene:
    return rooms.scene("test", 3, 3, 64, 48)


def test_preview_shows_image_depth_and_labels_side_by_side(scene):
    palette = np.arange(60, dtype=np.uint8).reshape(20, 3)
    sheet = np.array(rooms.preview_sheet([scene, scene], palette))
    assert sheet.shape == (2 * 48, 3 * 64, 3)
    np.testing.assert_array_equal(sheet[:48, :64], scene.frame(0).image)
    labels = scene.frame(0).labels
    known = labels < 20
    np.testing.assert_array_equal(sheet[:48, 128:][known], palette[labels[known]])
    assert (sheet[:48, 128:][~known] == 0).all()


def test_many_rooms_fill_a_grid_about_as_wide_as_high(scene):
    sheet = np.array(rooms.preview_sheet([scene] * 11, np.zeros((20, 3), np.uint8)))
    assert sheet.shape == (6 * 48, 2 * 3 * 64, 3)
    np.testing.assert_array_equal(sheet[:48, 192:256], scene.frame(0).image)
    assert not sheet[-48:, 192:].any()
