"""The weights and the sample room that come with the package."""

import numpy as np
import pytest
import torch

from mvsam import weights
from mvsam.data.catalog import open_data
from mvsam.data.dataset import TupleDataset
from mvsam.data.formats import open_scene
from mvsam.data.labels import SCANNET20
from mvsam.evaluation.evaluate import Scores, evaluate
from mvsam.evaluation.protocols import PROTOCOLS
from mvsam.evaluation.yardsticks import MajorityLabel, MeasuredMedianDepth, majority_label
from mvsam.precision import autocast


@pytest.fixture(scope="module")
def samples() -> list:
    data = TupleDataset([open_scene(weights.ASSETS / "sample")], tuples_per_scene=2)
    return [data[index] for index in range(len(data))]


@pytest.fixture(scope="module")
def scores(samples: list) -> Scores:
    with autocast("cpu"):
        return evaluate(weights.load("tiny"), samples, PROTOCOLS["paper"])


def test_tiny_knows_the_depth_of_the_sample_room(scores: Scores, samples: list):
    protocol = PROTOCOLS["paper"]
    median = evaluate(MeasuredMedianDepth(protocol), samples, protocol)
    assert scores.as_json()["rel"] < 0.5 * median.as_json()["rel"]


def test_tiny_knows_more_labels_of_the_sample_room_than_the_most_frequent(
    scores: Scores, samples: list
):
    label = majority_label(targets for _, _, targets in samples)
    assert label is not None
    constant = evaluate(MajorityLabel(label), samples, PROTOCOLS["paper"])
    assert scores.as_json()["miou"] > constant.as_json()["miou"]
    assert scores.as_json()["accuracy"] > constant.as_json()["accuracy"]


def test_the_depth_of_tiny_has_no_stripes(samples: list):
    """Metres from row to row and column to column; with stripes .0045 and .0033."""
    _, views, _ = samples[0]
    with autocast("cpu"), torch.inference_mode():
        depth = weights.load("tiny").eval()(views).depth[0]
    across_rows, across_columns = (depth.diff(n=2, dim=axis).abs().median() for axis in (0, 1))
    assert across_rows < 1.25 * across_columns and across_rows < 0.002


def test_tiny_says_what_it_was_trained_for_and_by_what():
    info = weights.load("tiny").info
    assert isinstance(info, weights.WeightsInfo)
    assert info.classes == SCANNET20.names and info.palette == SCANNET20.colors
    assert info.training["run"].startswith("tiny") and info.training["commit"]


def test_the_weights_are_small_enough_to_come_with_the_package():
    assert (weights.ASSETS / "tiny.safetensors").stat().st_size < 15e6


def test_the_sample_is_the_first_room_of_rooms_val():
    """What `mvsam rooms export rooms:val:0-1` writes now."""
    kept, room = open_scene(weights.ASSETS / "sample"), open_data("rooms:val:0-1")[0]
    assert len(kept) == len(room)
    for index in range(len(room)):
        ours, theirs = kept.frame(index), room.frame(index)
        np.testing.assert_allclose(ours.intrinsics, theirs.intrinsics, atol=1e-4)
        np.testing.assert_allclose(ours.world_from_cam, theirs.world_from_cam, atol=1e-6)
        assert ours.depth is not None and theirs.depth is not None
        assert np.mean(np.abs(ours.depth - theirs.depth) < 0.002) > 0.999, "processors may round"
        assert np.mean(ours.labels == theirs.labels) > 0.999
