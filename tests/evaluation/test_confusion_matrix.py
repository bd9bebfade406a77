import numpy as np
import pytest
import torch

from mvsam.evaluation.metrics import ConfusionMatrix
from mvsam.types import IGNORE
from tests.reference.metrics import iou_of_class

rng = np.random.default_rng(0)


def matrix_of(predicted, truth, num_classes: int) -> ConfusionMatrix:
    return ConfusionMatrix.of_labels(
        torch.as_tensor(np.asarray(predicted)), torch.as_tensor(np.asarray(truth)), num_classes
    )


def test_iou_agrees_with_a_loop_over_pixels():
    truth = rng.choice([0, 1, 2, 4, IGNORE], (9, 11))  # class 3 occurs only as a prediction
    predicted = np.where(rng.random(truth.shape) < 0.6, truth, rng.integers(0, 5, truth.shape))
    predicted[predicted == IGNORE] = 2
    matrix = matrix_of(predicted, truth, 6)
    expected = [iou_of_class(predicted, truth, c) for c in range(6)]
    assert matrix.iou() == expected
    assert expected[5] is None
    assert expected[3] == 0
    assert matrix.miou() == pytest.approx(sum(iou for iou in expected if iou is not None) / 5)


def test_ignored_truth_never_counts_not_even_as_a_false_positive():
    truth = np.array([0, 0, 1, 1])
    predicted = np.array([0, 0, 1, 0])
    plain = matrix_of(predicted, truth, 3)
    for wrong in (0, 1, 2, IGNORE):
        more = matrix_of(np.append(predicted, [wrong] * 5), np.append(truth, [IGNORE] * 5), 3)
        np.testing.assert_array_equal(more.counts, plain.counts)
    assert plain.iou() == [2 / 3, 1 / 2, None]


def test_a_class_in_neither_truth_nor_prediction_is_left_out_of_the_mean():
    assert matrix_of([0, 1], [0, 1], 20).miou() == 1


def test_a_class_that_is_only_predicted_counts_as_zero():
    assert matrix_of([0, 2], [0, 0], 3).iou() == [1 / 2, None, 0]


def test_a_pixel_left_unlabelled_by_the_prediction_is_a_miss():
    matrix = matrix_of([0, IGNORE], [0, 0], 2)
    assert matrix.iou() == [1 / 2, None]
    assert matrix.accuracy() == 1 / 2


def test_miou_comes_from_one_matrix_not_from_the_mean_over_images():
    first, second = matrix_of([0, 0, 0, 1], [0, 0, 0, 0], 2), matrix_of([1], [1], 2)
    assert first.miou() == pytest.approx(3 / 8)
    assert second.miou() == 1
    total = first + second
    assert total.iou() == [3 / 4, 1 / 2]
    assert total.miou() == pytest.approx(5 / 8)


def test_counts_are_true_class_by_predicted_class():
    matrix = matrix_of([1, 1, 0], [0, 0, 1], 2)
    np.testing.assert_array_equal(matrix.counts, [[0, 2, 0], [1, 0, 0]])
    assert matrix.counts.dtype == np.int64


def test_without_labels_there_is_no_score():
    matrix = matrix_of([0, 1], [IGNORE, IGNORE], 2)
    assert matrix.miou() is None
    assert matrix.accuracy() is None
    assert ConfusionMatrix.empty(2).miou() is None


@pytest.mark.parametrize(
    ("predicted", "truth", "reason"),
    [
        ([0], [2], "true labels reach from 2 to 2, but there are 2 classes"),
        ([3], [0], "predicted labels reach from 3 to 3"),
        ([-1], [0], "predicted labels reach from -1"),
        ([0], [-1], "true labels reach from -1"),
    ],
)
def test_a_label_beyond_the_classes_is_an_error(predicted, truth, reason):
    with pytest.raises(ValueError, match=reason):
        matrix_of(predicted, truth, 2)


def test_labels_of_8_bits_do_not_overflow():
    truth = np.full(300, 19, np.uint8)
    assert matrix_of(truth, truth, 20).counts[19, 19] == 300
