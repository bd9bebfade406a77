"""The legend of a preview says what its colours mean."""

import numpy as np

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


def test_the_metres_are_those_of_the_map():
    depth = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    depth[:, : WIDTH // 2] = 1.0
    legends = [legend_of(1, metres * depth, None)[:, :30] for metres in (1.0, 1.0, 2.0)]
    assert np.array_equal(legends[0], legends[1]) and not np.array_equal(legends[0], legends[2])


def test_depth_that_is_unknown_or_the_same_everywhere_has_a_legend_too():
    for metres in (0.0, 1.5):
        legend_of(1, np.full((HEIGHT, WIDTH), metres, np.float32), None)


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
