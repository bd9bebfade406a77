import math

import pytest
import torch

from mvsam.loss_terms import cross_entropy
from mvsam.training.losses import JointLoss, prior_loss
from mvsam.types import IGNORE, DepthPrior, DepthStage, Prediction, Targets
from tests.reference import losses as twin

RANGE = torch.tensor([[0.1, 5.0]])
ONE_STAGE = JointLoss(stage_weights=(1.0,))


def stage(depth: torch.Tensor) -> DepthStage:
    return DepthStage(depth[:, None], torch.ones_like(depth)[:, None], depth, depth)


@pytest.mark.parametrize("error, expected", [(0.01, 0.0025), (0.02, 0.01), (0.05, 0.04)])
def test_smooth_l1_turns_straight_at_two_centimetres(error: float, expected: float):
    target = torch.full((1, 2, 2), 2.0)
    loss = ONE_STAGE.depth([stage(target + error)], target, RANGE)
    assert loss.item() == pytest.approx(expected, abs=1e-6)
    assert twin.smooth_l1(error, 0.02) == pytest.approx(expected, abs=1e-12)


def test_depth_loss_equals_the_slow_twin():
    target = 6 * torch.rand(1, 6, 7) * (torch.rand(1, 6, 7) > 0.3)
    predicted = target + 0.05 * torch.randn(1, 6, 7)
    loss = ONE_STAGE.depth([stage(predicted)], target, RANGE)
    expected = twin.stage_depth_loss(predicted[0].tolist(), target[0].tolist(), 0.1, 5.0, 0.02)
    assert loss.item() == pytest.approx(expected, rel=1e-4)


def test_depth_outside_the_range_or_unknown_does_not_count():
    predicted = torch.full((1, 2, 2), 2.0)
    target = torch.tensor([[[2.5, 0.0], [0.05, 9.0]]])
    loss = ONE_STAGE.depth([stage(predicted)], target, RANGE)
    assert loss.item() == pytest.approx(0.49)


def test_each_item_s_own_range_decides():
    target = torch.full((2, 2, 2), 3.0)
    ranges = torch.tensor([[0.1, 5.0], [0.1, 2.0]])
    loss = ONE_STAGE.depth([stage(target + 0.5)], target, ranges)
    assert loss.item() == pytest.approx(0.49)
    assert ONE_STAGE.depth([stage(target + 0.5)], target, ranges[1:].expand(2, 2)) == 0


def test_no_valid_depth_gives_zero_loss_and_zero_gradient():
    predicted = torch.rand(1, 4, 4, requires_grad=True)
    loss = ONE_STAGE.depth([stage(predicted)], torch.zeros(1, 4, 4), RANGE)
    loss.backward()
    assert loss.item() == 0 and predicted.grad is not None and predicted.grad.eq(0).all()


def test_stages_are_weighted_a_half_one_and_two():
    target = torch.full((1, 8, 8), 2.0)
    stages = [stage(torch.full((1, side, side), 2.0)) for side in (2, 4, 8)]
    for index, weight in enumerate((0.5, 1.0, 2.0)):
        wrong = list(stages)
        wrong[index] = stage(stages[index].depth + 0.11)
        loss = JointLoss().depth(wrong, target, RANGE)
        assert loss.item() == pytest.approx(0.1 * weight, abs=1e-6)


def test_coarse_stages_see_the_nearest_true_pixel_and_no_mixture():
    # The centre of each 2 x 2 block is a corner of four pixels; the lower right one counts.
    target = 1 + torch.rand(1, 8, 8)
    assert ONE_STAGE.depth([stage(target[:, 1::2, 1::2])], target, RANGE) == 0
    # 3 x 3 blocks have a middle pixel.
    target = 1 + torch.rand(1, 9, 9)
    assert ONE_STAGE.depth([stage(target[:, 1::3, 1::3])], target, RANGE) == 0


def test_within_windows_only_pixels_whose_truth_lies_among_the_hypotheses_teach():
    loss = JointLoss(stage_weights=(1.0,), within_windows=True)
    hypotheses = torch.tensor([1.9, 2.1]).view(1, 2, 1, 1).expand(1, 2, 1, 2)
    predicted = torch.full((1, 1, 2), 1.95, requires_grad=True)
    window = DepthStage(hypotheses, torch.full((1, 2, 1, 2), 0.5), predicted, predicted)
    value = loss.depth([window], torch.tensor([[[2.05, 2.5]]]), RANGE)
    assert value.item() == pytest.approx(0.09, abs=1e-6)  # of the first pixel alone
    value.backward()
    assert predicted.grad is not None and predicted.grad[0, 0, 0] < 0 == predicted.grad[0, 0, 1]


def test_planes_share_the_truth_by_nearness_and_the_first_stage_alone_counts():
    hypotheses = torch.tensor([1.0, 2.0, 3.0]).view(1, 3, 1, 1).expand(1, 3, 1, 2)
    probability = torch.tensor([0.2, 0.5, 0.3]).view(1, 3, 1, 1).expand(1, 3, 1, 2)
    exact = torch.tensor([[[2.25, 0.0]]])  # the second pixel is unknown
    first = DepthStage(hypotheses, probability, exact, exact)
    loss = JointLoss(stage_weights=(1.0, 1.0), plane_weight=0.1)
    value = loss.depth([first, stage(exact)], exact, RANGE)
    assert value.item() == pytest.approx(-0.1 * (0.75 * math.log(0.5) + 0.25 * math.log(0.3)))


def test_planes_that_are_surely_wrong_still_learn():
    hypotheses = torch.tensor([1.0, 2.0, 3.0]).view(1, 3, 1, 1)
    scores = torch.tensor([0.0, -40.0, -40.0]).view(1, 3, 1, 1).requires_grad_()
    truth = torch.full((1, 1, 1), 3.0)
    first = DepthStage(hypotheses, scores.softmax(dim=1), truth, truth)
    JointLoss(stage_weights=(0.0,), plane_weight=1.0).depth([first], truth, RANGE).backward()
    assert scores.grad is not None and scores.grad[0, 2].item() == pytest.approx(-1)


def test_a_wrong_number_of_stages_is_refused():
    with pytest.raises(ValueError):
        JointLoss().depth([stage(torch.ones(1, 2, 2))], torch.ones(1, 2, 2), RANGE)


def test_segmentation_loss_equals_the_slow_twin():
    logits, labels = 3 * torch.randn(1, 4, 3, 5), torch.randint(4, (1, 3, 5))
    labels[torch.rand(1, 3, 5) < 0.3] = IGNORE
    expected = twin.cross_entropy(logits[0].tolist(), labels[0].tolist(), IGNORE)
    assert cross_entropy(logits, labels).item() == pytest.approx(expected, rel=1e-5)


def test_labels_that_are_all_ignored_give_zero_loss_and_zero_gradient():
    logits = torch.randn(1, 4, 3, 3, requires_grad=True)
    loss = cross_entropy(logits, torch.full((1, 3, 3), IGNORE))
    loss.backward()
    assert loss.item() == 0 and logits.grad is not None and logits.grad.eq(0).all()


def test_class_weights_count_pixels_as_a_weighted_mean_does():
    logits, weights = torch.randn(2, 3, 4, 5), (0.2, 1.0, 3.0)
    labels = torch.randint(0, 3, (2, 4, 5))
    labels[0, 0] = IGNORE
    expected = torch.nn.functional.cross_entropy(
        logits, labels, torch.tensor(weights), ignore_index=IGNORE
    )
    torch.testing.assert_close(cross_entropy(logits, labels, weights), expected)
    with pytest.raises(ValueError, match="2 class weights for 3 classes"):
        cross_entropy(logits, labels, (1.0, 2.0))


def test_eq_4_is_segmentation_plus_alpha_times_depth():
    target = Targets(torch.full((1, 4, 4), 2.0), torch.randint(3, (1, 4, 4)))
    prediction = Prediction(logits=torch.randn(1, 3, 4, 4), stages=[stage(target.depth + 0.3)])
    parts = JointLoss(alpha=0.25, stage_weights=(1.0,))(prediction, target, RANGE)
    assert parts["depth"].item() == pytest.approx(0.29)
    torch.testing.assert_close(parts["loss"], parts["segmentation"] + 0.25 * parts["depth"])


def test_each_stage_has_a_weight():
    target = Targets(torch.full((1, 4, 4), 2.0), torch.zeros(1, 4, 4, dtype=torch.long))
    with pytest.raises(ValueError, match=r"1 stages, and --loss\.stage-weights gives 3"):
        JointLoss()(Prediction(stages=[stage(target.depth)]), target, RANGE)


def test_a_model_of_one_task_has_that_loss_alone():
    target = Targets(torch.full((1, 4, 4), 2.0), torch.zeros(1, 4, 4, dtype=torch.long))
    depth = ONE_STAGE(Prediction(stages=[stage(target.depth)]), target, RANGE)
    labels = ONE_STAGE(Prediction(logits=torch.zeros(1, 3, 4, 4)), target, RANGE)
    assert set(depth) == {"loss", "depth"} and set(labels) == {"loss", "segmentation"}
    with pytest.raises(ValueError, match="no depth stages, logits or prior"):
        ONE_STAGE(Prediction(), target, RANGE)


def test_a_depth_without_stages_is_refused_not_left_untrained():
    target = Targets(torch.full((1, 4, 4), 2.0), torch.zeros(1, 4, 4, dtype=torch.long))
    prediction = Prediction(depth=target.depth, logits=torch.zeros(1, 3, 4, 4))
    with pytest.raises(ValueError, match="train it by its own method's loss"):
        JointLoss()(prediction, target, RANGE)


def test_the_prior_s_loss_is_laplace_s_likelihood_where_depth_is_known():
    depth = torch.tensor([[[2.0, 0.0], [1.0, 9.0]]])
    prior = DepthPrior(torch.zeros(1, 2, 2), torch.full((1, 2, 2), math.log(4.0)))
    expected = (4 * math.log(2.0) - math.log(4.0) - math.log(4.0)) / 2
    assert prior_loss(prior, depth, RANGE).item() == pytest.approx(expected, abs=1e-6)


def test_the_prior_s_loss_is_weighed_and_reaches_it_alone():
    log_median = torch.zeros(1, 2, 2, requires_grad=True)
    prior = DepthPrior(log_median, torch.zeros(1, 2, 2))
    targets = Targets(torch.full((1, 2, 2), 2.0), torch.zeros(1, 2, 2, dtype=torch.int64))
    parts = JointLoss(prior_weight=0.25)(Prediction(prior=prior), targets, RANGE)
    assert parts["loss"].item() == pytest.approx(0.25 * math.log(2.0))
    parts["loss"].backward()
    assert log_median.grad is not None and (log_median.grad < 0).all()
