import pytest
import torch

from mvsam.evaluation import PROTOCOLS
from mvsam.evaluation.evaluate import score_item
from mvsam.types import IGNORE, Prediction, Targets

FULL = (480, 640)


def targets(depth: float = 2.0, label: int = 3) -> Targets:
    return Targets(torch.full((1, *FULL), depth), torch.full((1, *FULL), label))


def test_mvs2d_counts_truth_between_half_a_metre_and_ten_without_the_bounds():
    depth = torch.tensor([0.0, 0.5, 0.501, 5.5, 9.999, 10.0])
    valid = PROTOCOLS["mvs2d"].valid_depth(depth)
    assert valid.tolist() == [False, False, True, True, True, False]


@pytest.mark.parametrize("name, rel", [("mvs2d", 0.25), ("scannet-2d", 0.9)])
def test_only_mvs2d_clamps_predictions_to_its_range(name, rel):
    near = Prediction(depth=torch.full((1, 256, 320), 0.2))
    scores = score_item(near, targets(2.0), 0, PROTOCOLS[name]).as_json()
    assert scores["rel"] == pytest.approx(0.75 if name == "mvs2d" else rel)


def test_predictions_are_enlarged_to_the_truth_by_nearest_pixels():
    depth = torch.full((1, 2, 2), 1.0)
    depth[0, 0, 1] = 2.0
    truth = torch.full((1, *FULL), 1.0)
    truth[0, :240, 320:] = 2.0
    scores = score_item(
        Prediction(depth=depth), Targets(truth, targets().labels), 0, PROTOCOLS["scannet-2d"]
    )
    assert scores.as_json()["abs"] == 0


def test_ignored_pixels_are_no_false_positives_and_unlabelled_answers_are_misses():
    labels = torch.full((1, *FULL), IGNORE)
    labels[0, :, :320] = 3
    logits = torch.zeros(1, 20, 2, 4)
    logits[:, 3] = 1
    perfect = Prediction(logits=logits)
    truth = Targets(torch.zeros(1, *FULL), labels)
    scores = score_item(perfect, truth, 0, PROTOCOLS["scannet-2d"]).as_json()
    assert scores["miou"] == 1.0 and scores["iou"][3] == 1.0


def test_confidence_is_scored_where_there_is_some():
    depth = torch.full((1, 2, 2), 1.0)
    without = score_item(Prediction(depth=depth), targets(), 0, PROTOCOLS["mvs2d"]).as_json()
    assert without["ause"] is None
    sure = Prediction(depth=depth, confidence=torch.rand(1, 2, 2))
    assert score_item(sure, targets(), 0, PROTOCOLS["mvs2d"]).as_json()["ause"] == 0


@pytest.mark.parametrize("name, size", [("paper", (320, 256)), ("mvs2d", (640, 480))])
def test_truth_has_the_protocols_size(name, size):
    assert PROTOCOLS[name].truth_size == size
