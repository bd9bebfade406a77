import io
import json
import math

import pytest
import torch
from rich.console import Console
from torch import nn

from mvsam.evaluation import PROTOCOLS, Protocol, Scores, evaluate
from mvsam.types import IGNORE, Prediction, Targets, Views

TINY = Protocol("tiny", size=(6, 4))
KEYS = ("abs", "rel", "rmse", "delta_1.03", "delta_1.05", "delta_1.25", "miou")


def sample(name, depth: float, label: int, batch: int = 1) -> tuple:
    """A scene of one depth and one label, whose image holds the true depth / 10."""
    images = torch.full((batch, 2, 3, 4, 6), depth / 10)
    views = Views(
        images=images,
        intrinsics=torch.eye(3).expand(batch, 2, 3, 3),
        world_from_cam=torch.eye(4).expand(batch, 2, 4, 4),
        depth_range=torch.tensor([[0.1, 5.0]] * batch),
    )
    labels = torch.full((batch, 4, 6), label)
    return name, views, Targets(depth=torch.full((batch, 4, 6), depth), labels=labels)


def ten_percent_too_far(views: Views) -> Prediction:
    return Prediction(depth=views.images[:, 0, 0] * 11)


def always_class_one(views: Views) -> Prediction:
    logits = torch.zeros(len(views.images), 3, 4, 6)
    logits[:, 1] = 1
    return Prediction(logits=logits)


def test_json_has_the_promised_keys_in_total_and_for_each_scene():
    scores = evaluate(ten_percent_too_far, [sample("a", 1.0, 0), sample("b", 2.0, 0)], TINY)
    report = json.loads(json.dumps(scores.as_json(), allow_nan=False))
    assert report["protocol"] == "tiny"
    assert set(KEYS) <= report.keys()
    assert list(report["scenes"]) == ["a", "b"]
    assert all(set(KEYS) <= scene.keys() for scene in report["scenes"].values())
    assert report["scenes"]["b"]["abs"] == pytest.approx(0.2)
    assert report["abs"] == pytest.approx(0.15)
    assert report["rel"] == pytest.approx(0.1)
    assert report["delta_1.05"] == 0
    assert report["delta_1.25"] == 1
    assert report["num_images"] == 2


def test_a_task_that_is_absent_is_null():
    depth_only = evaluate(ten_percent_too_far, [sample("a", 1.0, 0)], TINY).as_json()
    assert depth_only["miou"] is None
    assert depth_only["scenes"]["a"]["miou"] is None
    labels_only = evaluate(always_class_one, [sample("a", 1.0, 1)], TINY).as_json()
    assert all(labels_only[key] is None for key in KEYS if key != "miou")
    assert labels_only["miou"] == 1


def test_missing_ground_truth_is_null_too():
    scores = evaluate(ten_percent_too_far, [sample("a", 0.0, 0)], TINY).as_json()
    assert scores["rel"] is None
    scores = evaluate(always_class_one, [sample("a", 1.0, IGNORE)], TINY).as_json()
    assert scores["miou"] is None


def test_total_miou_comes_from_one_confusion_matrix():
    samples = [sample("a", 1.0, 1, batch=3), sample("b", 1.0, 0)]
    scores = evaluate(always_class_one, samples, TINY).as_json()
    assert scores["scenes"]["a"]["miou"] == 1
    assert scores["scenes"]["b"]["miou"] == 0
    assert scores["iou"] == [0, pytest.approx(3 / 4), None]
    assert scores["miou"] == pytest.approx(3 / 8)
    assert scores["accuracy"] == pytest.approx(3 / 4)


def test_depth_outside_the_protocols_range_is_left_out():
    samples = [sample("near", 1.0, 0), sample("far", 6.0, 0)]
    scores = evaluate(ten_percent_too_far, samples, TINY).as_json()
    assert scores["abs"] == pytest.approx(0.1)
    assert scores["scenes"]["far"]["abs"] is None


def test_a_batch_may_mix_scenes():
    _, views, targets = sample("", 2.0, 0, batch=3)
    mixed = evaluate(ten_percent_too_far, [(["a", "b", "a"], views, targets)], TINY)
    assert [s.num_images for s in mixed.scenes.values()] == [2, 1]
    one_by_one = evaluate(
        ten_percent_too_far, [sample(name, 2.0, 0) for name in ("a", "b", "a")], TINY
    )
    assert mixed.as_json() == one_by_one.as_json()


def test_shares_of_two_processes_add_up_to_one_run():
    samples = [sample("a", 1.0, 0), sample("b", 2.0, 0), sample("a", 3.0, 0)]
    whole = evaluate(ten_percent_too_far, samples, TINY)
    joined = evaluate(ten_percent_too_far, samples[:2], TINY) + evaluate(
        ten_percent_too_far, samples[2:], TINY
    )
    assert joined.as_json() == whole.as_json()


def test_targets_of_another_size_are_refused():
    with pytest.raises(ValueError, match="protocol paper wants ground truth of 320x256, got 6x4"):
        evaluate(ten_percent_too_far, [sample("a", 1.0, 0)], PROTOCOLS["paper"])


class Watcher(nn.Module):
    """Notes the state it is called in."""

    def __init__(self):
        super().__init__()
        self.scale = nn.Parameter(torch.tensor(10.0))

    def forward(self, views: Views) -> Prediction:
        self.was_training, self.had_gradients = self.training, torch.is_grad_enabled()
        return Prediction(depth=views.images[:, 0, 0] * self.scale)


@pytest.mark.parametrize("training", [True, False])
def test_a_module_is_evaluated_without_gradients_and_gets_its_mode_back(training):
    model = Watcher().train(training)
    scores = evaluate(model, [sample("a", 2.0, 0)], TINY).as_json()
    assert scores["rel"] == pytest.approx(0, abs=1e-6)
    assert not model.was_training
    assert not model.had_gradients
    assert model.training == training


def test_a_module_gets_its_mode_back_after_a_failure():
    model = Watcher().train()
    with pytest.raises(ValueError, match="wants ground truth"):
        evaluate(model, [sample("a", 1.0, 0)], PROTOCOLS["paper"])
    assert model.training


def test_progress_counts_images():
    done = []
    samples = [sample("a", 1.0, 0, batch=2), sample("b", 1.0, 0)]
    evaluate(ten_percent_too_far, samples, TINY, progress=done.append)
    assert done == [2, 3]


def test_no_samples_give_no_scores():
    scores = evaluate(ten_percent_too_far, [], TINY).as_json()
    assert all(scores[key] is None for key in KEYS)
    assert scores["scenes"] == {}


def test_the_table_shows_every_scene_the_total_and_gaps_as_a_dash():
    scores = evaluate(ten_percent_too_far, [sample("kitchen", 1.0, 0)], TINY)
    console = Console(width=120, record=True, file=io.StringIO())
    console.print(scores.as_table())
    text = console.export_text()
    assert "protocol: tiny" in text
    (kitchen,) = (line for line in text.splitlines() if "kitchen" in line)
    (total,) = (line for line in text.splitlines() if "total" in line)
    assert "10.0" in kitchen and "10.0" in total
    assert " - " in kitchen


def test_bfloat16_predictions_are_scored():
    def coarse(views: Views) -> Prediction:
        return Prediction(depth=(views.images[:, 0, 0] * 10).bfloat16())

    scores = evaluate(coarse, [sample("a", 2.0, 0)], TINY).as_json()
    assert not math.isnan(scores["rel"])
    assert scores["rel"] < 0.01


def test_scores_of_other_protocols_do_not_add_up():
    with pytest.raises(AssertionError):
        _ = Scores("paper") + Scores("real")
