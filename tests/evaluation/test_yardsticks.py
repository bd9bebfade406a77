import pytest
import torch

from mvsam.evaluation import Protocol, evaluate
from mvsam.evaluation.yardsticks import (
    ConstantMedianDepth,
    MajorityLabel,
    MeasuredMedianDepth,
    majority_label,
    median_depth,
)
from mvsam.types import IGNORE, Targets, Views

PROTOCOL = Protocol("tiny", size=(3, 1))


def targets(depth: list[float], labels: list[int]) -> Targets:
    return Targets(depth=torch.tensor([[depth]]), labels=torch.tensor([[labels]]))


def views(measured: list[float] | None = None) -> Views:
    return Views(
        images=torch.zeros(1, 2, 3, 1, 3),
        intrinsics=torch.eye(3).expand(1, 2, 3, 3),
        world_from_cam=torch.eye(4).expand(1, 2, 4, 4),
        depth_range=torch.tensor([[0.1, 5.0]]),
        measured_depth=None if measured is None else torch.tensor([[measured]]),
    )


TRUTH = [targets([1.0, 2.0, 0.0], [4, 4, IGNORE]), targets([3.0, 9.0, 0.0], [2, IGNORE, IGNORE])]


def test_median_depth_is_that_of_valid_pixels():
    assert median_depth(TRUTH, PROTOCOL) == 2.0
    assert median_depth([], PROTOCOL) is None


def test_majority_label_ignores_unlabelled_pixels():
    assert majority_label(TRUTH) == 4
    assert majority_label([targets([1.0] * 3, [IGNORE] * 3)]) is None


def test_the_constants_are_scored_like_any_model():
    samples = [("room", views(), t) for t in TRUTH]
    depth = evaluate(ConstantMedianDepth(2.0), samples, PROTOCOL).as_json()
    assert depth["rel"] == pytest.approx(((1 + 0) / 2 + 1 / 3) / 2)
    assert depth["miou"] is None
    labels = evaluate(MajorityLabel(4), samples, PROTOCOL).as_json()
    assert labels["miou"] == pytest.approx((2 / 3 + 0) / 2)
    assert labels["rel"] is None


def test_the_measured_median_is_taken_within_each_image():
    model = MeasuredMedianDepth(PROTOCOL)

    def constants_for(*measured: float) -> list[float]:
        depth = model(views(list(measured))).depth
        assert depth is not None
        return depth.unique().tolist()

    assert constants_for(1.0, 3.0, 4.0) == [3.0]
    assert constants_for(0.0, 2.0, 9.0) == [2.0]
    assert constants_for(0.0, 0.0, 0.0) == [pytest.approx(2.55)]
    with pytest.raises(ValueError, match="needs the measured depth"):
        model(views())
