import json

import numpy as np
import pytest
from PIL import Image

from mvsam.data.labels import SCANNET20, ClassTable, colorize, png_palette, read_class_table
from mvsam.errors import InputError
from mvsam.types import IGNORE


def test_scannet_has_the_20_benchmark_classes_in_order():
    assert len(SCANNET20) == 20
    assert SCANNET20.names[:5] == ("wall", "floor", "cabinet", "bed", "chair")
    assert SCANNET20.names[15] == "shower curtain"
    assert SCANNET20.names[19] == "otherfurniture"
    assert SCANNET20.colors[0] == (174, 199, 232)
    assert SCANNET20.colors[19] == (82, 84, 163)
    assert len(set(SCANNET20.colors)) == 20


def test_unlabelled_pixels_are_black_and_others_have_their_class_color():
    labels = np.array([[0, 19, IGNORE]], np.uint8)
    expected = [[SCANNET20.colors[0], SCANNET20.colors[19], (0, 0, 0)]]
    np.testing.assert_array_equal(colorize(labels), expected)


def test_palette_png_shows_the_colors_and_keeps_the_numbers(tmp_path):
    labels = np.array([[0, 7, 19, IGNORE]], np.uint8)
    picture = Image.fromarray(labels)
    picture.putpalette(png_palette())
    picture.save(tmp_path / "labels.png")
    with Image.open(tmp_path / "labels.png") as stored:
        np.testing.assert_array_equal(np.array(stored), labels)
        np.testing.assert_array_equal(np.array(stored.convert("RGB")), colorize(labels))


def test_a_class_table_needs_a_color_for_every_name():
    with pytest.raises(ValueError, match="2 class names but 1 colours"):
        ClassTable(("a", "b"), ((0, 0, 0),))


def test_classes_json_is_read_in_order(tmp_path):
    file = tmp_path / "classes.json"
    file.write_text(json.dumps([{"name": n, "color": [i, 2, 3]} for i, n in enumerate("ba")]))
    assert read_class_table(file) == ClassTable(("b", "a"), ((0, 2, 3), (1, 2, 3)))


@pytest.mark.parametrize(
    "content",
    [
        "not json",
        "{}",
        "3",
        '["wall"]',
        '[{"name": "wall"}]',
        '[{"name": "", "color": [1, 2, 3]}]',
        '[{"name": "wall", "color": [1, 2]}]',
        '[{"name": "wall", "color": [1, 2, 256]}]',
        '[{"name": "wall", "color": "red"}]',
        json.dumps([{"name": str(i), "color": [0, 0, 0]} for i in range(256)]),
    ],
)
def test_a_malformed_classes_json_is_named_with_the_expected_form(tmp_path, content):
    file = tmp_path / "classes.json"
    file.write_text(content)
    with pytest.raises(InputError, match=r"classes\.json: not a class table .*; expected a list"):
        read_class_table(file)
