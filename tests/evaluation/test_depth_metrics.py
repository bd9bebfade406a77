from itertools import pairwise

import numpy as np
import pytest
import torch

from mvsam.evaluation.metrics import DepthMetrics, rel_of_most_confident
from mvsam.evaluation.protocols import PROTOCOLS
from tests.reference.metrics import depth_scores

rng = np.random.default_rng(0)


def random_image(height: int = 7, width: int = 9) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    truth = rng.uniform(0.2, 4, (height, width)).astype(np.float32)
    predicted = (truth * rng.normal(1, 0.1, truth.shape)).astype(np.float32)
    return predicted, truth, rng.random(truth.shape) < 0.7


def metrics_of(images) -> DepthMetrics:
    tensors = [map(torch.from_numpy, image) for image in images]
    return sum((DepthMetrics.of_image(*image) for image in tensors), DepthMetrics())


def one_row(*values: float) -> torch.Tensor:
    return torch.tensor([values], dtype=torch.float32)


def test_scores_agree_with_a_loop_over_pixels():
    images = [random_image() for _ in range(4)]
    assert metrics_of(images).scores() == pytest.approx(depth_scores(images), rel=1e-12)


def test_scores_by_hand():
    truth = one_row(1.0, 2.0, 4.0, 2.0)
    predicted = one_row(1.1, 2.0, 3.0, 9.0)
    valid = torch.tensor([[True, True, True, False]])
    scores = DepthMetrics.of_image(predicted, truth, valid).scores()
    assert scores["abs"] == pytest.approx((0.1 + 0 + 1) / 3)
    assert scores["rel"] == pytest.approx((0.1 + 0 + 0.25) / 3)
    assert scores["rmse"] == pytest.approx(((0.01 + 0 + 1) / 3) ** 0.5)
    assert scores["delta_1.03"] == pytest.approx(1 / 3)
    assert scores["delta_1.25"] == pytest.approx(2 / 3)


def test_images_weigh_equally_however_many_valid_pixels_they_have():
    valid = torch.tensor([[True, False, False]])
    near = DepthMetrics.of_image(one_row(1.5, 0, 0), one_row(1, 1, 1), valid)
    far = DepthMetrics.of_image(one_row(1, 1, 1), one_row(1, 1, 1), torch.full((1, 3), True))
    scores = (near + far).scores()
    assert scores["rel"] == pytest.approx(0.25)
    assert scores["rmse_pooled"] == pytest.approx((0.25 / 4) ** 0.5)


def test_an_image_without_a_valid_pixel_counts_nowhere():
    image = random_image()
    empty = (image[0], image[1], np.zeros_like(image[2]))
    assert metrics_of([image, empty]) == metrics_of([image])
    assert metrics_of([empty]).num_images == 0


def test_without_any_image_every_score_is_none():
    assert set(DepthMetrics().scores().values()) == {None}


def test_merged_shares_equal_one_pass():
    images = [random_image() for _ in range(5)]
    merged = metrics_of(images[:2]) + metrics_of(images[2:])
    assert merged.scores() == pytest.approx(metrics_of(images).scores(), rel=1e-12)


@pytest.mark.parametrize("depth", [0.0, -1.0])
def test_a_depth_of_zero_or_below_is_never_within_a_ratio(depth):
    """-1 m over 1 m is a ratio of -1, which is smaller than 1.03."""
    valid = torch.full((1, 1), True)
    scores = DepthMetrics.of_image(one_row(depth), one_row(1.0), valid).scores()
    assert scores["delta_1.25"] == 0


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_prediction_that_is_not_finite_is_an_error_where_it_counts(value):
    with pytest.raises(ValueError, match="not finite"):
        DepthMetrics.of_image(one_row(value), one_row(1.0), torch.full((1, 1), True))
    unseen = torch.tensor([[False, True]])
    assert DepthMetrics.of_image(one_row(value, 1.0), one_row(1.0, 1.0), unseen).abs == 0


def test_wild_values_outside_the_valid_pixels_change_nothing():
    predicted, truth, valid = random_image()
    wild = np.where(valid, predicted, 1e9).astype(np.float32), np.where(valid, truth, 0.0), valid
    assert metrics_of([(wild[0], wild[1].astype(np.float32), valid)]) == metrics_of(
        [(predicted, truth, valid)]
    )


def test_more_noise_never_scores_better():
    truth = torch.from_numpy(rng.uniform(0.5, 4, (40, 50)).astype(np.float32))
    noise = torch.from_numpy(rng.normal(0, 1, truth.shape).astype(np.float32))
    valid = torch.full(truth.shape, True)
    scores = [
        DepthMetrics.of_image(truth + level * noise, truth, valid).scores()
        for level in (0.0, 0.1, 0.2, 0.4)
    ]
    for name in ("abs", "rel", "rmse", "rmse_pooled"):
        assert_rises([score[name] for score in scores])
    for name in ("delta_1.03", "delta_1.05", "delta_1.25"):
        assert_rises([score[name] for score in reversed(scores)])


def assert_rises(values) -> None:
    assert all(smaller < larger for smaller, larger in pairwise(values)), values


def test_the_papers_range_includes_its_bounds_and_the_real_one_does_not():
    depth = torch.tensor([0.0, 0.099, 0.1, 0.101, 4.999, 5.0, 5.001])
    paper, real = PROTOCOLS["paper"], PROTOCOLS["real"]
    assert paper.valid_depth(depth).tolist() == [False, False, True, True, True, True, False]
    assert real.valid_depth(depth).tolist() == [False, False, False, True, True, False, False]


def test_bounds_hold_for_depth_read_from_millimetres():
    """100 mm is 0.1 m exactly, although float32's 0.1 is larger than Python's."""
    depth = torch.from_numpy(np.array([100, 5000], np.uint16).astype(np.float32) / 1000)
    assert PROTOCOLS["paper"].valid_depth(depth).all()
    assert not PROTOCOLS["real"].valid_depth(depth).any()


def test_unknown_depth_is_never_valid_even_if_the_range_starts_at_zero():
    protocol = type(PROTOCOLS["paper"])("from zero", depth_range=(0.0, 5.0))
    assert not protocol.valid_depth(torch.zeros(3)).any()


def test_the_most_confident_pixels_are_those_that_are_kept():
    truth = torch.ones(2, 5)
    error = torch.arange(10).reshape(2, 5) / 10
    valid = torch.full((2, 5), True)
    honest = rel_of_most_confident(truth + error, 1 - error, truth, valid, 0.3)
    assert honest == pytest.approx((0 + 0.1 + 0.2) / 3)
    everything = rel_of_most_confident(truth + error, 1 - error, truth, valid, 1.0)
    assert everything == pytest.approx(0.45)
    assert rel_of_most_confident(truth, truth, truth, ~valid, 0.5) is None
