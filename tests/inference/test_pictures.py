"""The legend of a preview says what its colours mean."""

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from mvsam.data.labels import SCANNET20
from mvsam.inference.pictures import LEGEND_HEIGHT, NEAR_TO_FAR, preview

HEIGHT, WIDTH = 60, 200
PHOTO = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)


def legend_of(panel: int, depth: np.ndarray | None, labels: np.ndarray | None) -> np.ndarray:
    picture = np.array(preview(PHOTO, depth, labels, SCANNET20))
    assert picture.shape[0] == HEIGHT + LEGEND_HEIGHT
    return picture[HEIGHT:, panel * WIDTH : (panel + 1) * WIDTH]


def colors_of(legend: np.ndarray) -> set[tuple[int, ...]]:
    return {tuple(color) for color in legend.reshape(-1, 3).tolist()}


def test_the_bar_below_depth_goes_from_near_to_far():
    depth = np.linspace(1, 4, HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
    middle = legend_of(1, depth, None)[LEGEND_HEIGHT // 2].tolist()
    near, far = NEAR_TO_FAR[0].tolist(), NEAR_TO_FAR[-1].tolist()
    assert middle.index(near) < middle.index(far)


def halves(near: float, far: float) -> np.ndarray:
    depth = np.full((HEIGHT, WIDTH), far, np.float32)
    depth[:, : WIDTH // 2] = near
    return depth


def test_the_metres_are_those_of_the_map():
    legend = legend_of(1, halves(1.0, 4.0), None)
    written = Image.new("RGB", (WIDTH, LEGEND_HEIGHT), "white")
    draw, font = ImageDraw.Draw(written), ImageFont.load_default(size=11)
    draw.text((4, LEGEND_HEIGHT / 2), "1.00 m", "black", font, anchor="lm")
    draw.text((WIDTH - 4, LEGEND_HEIGHT / 2), "4.00 m", "black", font, anchor="rm")
    for end in (slice(0, 36), slice(-36, None)):
        assert np.array_equal(legend[:, end], np.array(written)[:, end])


def test_a_narrow_panel_has_no_metres_rather_than_some_on_top_of_each_other():
    picture = np.array(preview(PHOTO[:, :60], halves(1.0, 4.0)[:, :60], None, SCANNET20))
    assert (picture[HEIGHT:] == 255).all()


def test_depth_that_is_unknown_everywhere_has_an_empty_legend():
    for metres in (0.0, np.inf):
        legend = legend_of(1, np.full((HEIGHT, WIDTH), metres, np.float32), None)
        assert (legend[:, :, 0] == 255).all()


def test_depth_that_is_the_same_everywhere_or_infinite_in_places_has_a_legend():
    for depth in (halves(1.5, 1.5), halves(1.5, np.inf)):
        assert (legend_of(1, depth, None)[:, :36] < 255).any()


def test_below_the_labels_stand_the_classes_that_are_there():
    labels = np.full((HEIGHT, WIDTH), 255, np.uint8)
    labels[:30], labels[30:40] = 4, 6
    colors = colors_of(legend_of(1, None, labels))
    assert {SCANNET20.colors[4], SCANNET20.colors[6]} <= colors
    assert SCANNET20.colors[0] not in colors


def test_of_many_classes_the_largest_are_named_and_none_is_cut_off():
    labels = np.minimum(np.arange(HEIGHT * WIDTH) // 500, 19).astype(np.uint8)
    labels = labels.reshape(HEIGHT, WIDTH)
    legend = legend_of(1, None, labels)
    assert SCANNET20.colors[19] in colors_of(legend)  # the largest
    assert len(colors_of(legend) & set(SCANNET20.colors)) < 20
    assert (legend[:, -3:] == 255).all()


def test_unlabelled_pixels_are_no_class():
    labels = np.full((HEIGHT, WIDTH), 255, np.uint8)
    assert (legend_of(1, None, labels) == 255).all()
