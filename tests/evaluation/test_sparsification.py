import numpy as np
import pytest
import torch

from mvsam.evaluation.sparsification import Sparsification
from tests.reference.metrics import ause

EVERYWHERE = torch.full((6, 8), True)


def maps(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """(predicted, confidence, truth), metres; all confidences differ."""
    dice = np.random.default_rng(seed)
    truth = torch.from_numpy(dice.uniform(1, 4, (6, 8)))
    confidence = torch.from_numpy(dice.permutation(48).reshape(6, 8) / 48)
    return truth + 0.1 * torch.from_numpy(dice.normal(size=(6, 8))), confidence, truth


@pytest.mark.parametrize("seed", range(3))
def test_ause_agrees_with_the_slow_twin(seed):
    predicted, confidence, truth = maps(seed)
    score = Sparsification.of_image(predicted, confidence, truth, EVERYWHERE).score()
    expected = ause(predicted.numpy(), confidence.numpy(), truth.numpy())
    assert score == pytest.approx(expected, rel=1e-12)


def test_confidence_that_orders_as_the_errors_do_has_no_sparsification_error():
    predicted, _, truth = maps()
    rel = (predicted - truth).abs() / truth
    assert Sparsification.of_image(predicted, -rel, truth, EVERYWHERE).ause == pytest.approx(0)
    opposite = Sparsification.of_image(predicted, rel, truth, EVERYWHERE).ause
    chance = Sparsification.of_image(predicted, torch.ones_like(rel), truth, EVERYWHERE).ause
    assert opposite > chance > 0


def test_equal_confidences_are_in_no_order():
    predicted, confidence, truth = maps()
    coarse = (confidence * 3).floor()
    there = Sparsification.of_image(predicted, coarse, truth, EVERYWHERE).ause
    back = Sparsification.of_image(
        predicted.flip(0, 1), coarse.flip(0, 1), truth.flip(0, 1), EVERYWHERE
    ).ause
    assert there == pytest.approx(back, rel=1e-12)


def test_images_without_truth_count_nowhere_and_the_score_is_a_mean_over_images():
    nothing = Sparsification.of_image(*maps(), ~EVERYWHERE)
    assert nothing.score() is None
    first, second = (Sparsification.of_image(*maps(seed), EVERYWHERE) for seed in (0, 1))
    total = nothing + first + second
    assert total.num_images == 2
    assert total.score() == pytest.approx((first.ause + second.ause) / 2)
