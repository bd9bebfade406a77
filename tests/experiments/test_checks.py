"""What a run is told before it begins."""

import logging
from dataclasses import replace
from pathlib import Path

import pytest

from mvsam.build import build
from mvsam.errors import InputError
from mvsam.experiments.checks import cascade_of, check_settings, check_truth
from mvsam.experiments.config import Experiment, ModelConfig
from tests.experiments.small_run import small_experiment
from tests.synthetic import write_posed_folder


@pytest.fixture
def experiment(tmp_path: Path) -> Experiment:
    return small_experiment(tmp_path / "room", 1, "auto")


@pytest.mark.parametrize(
    ("option", "value"),
    [("num_views", 0), ("fewest_views", 0), ("references", 0), ("singles_per_sample", 0)],
)
def test_counts_below_one_are_refused(experiment: Experiment, option: str, value: int):
    data = replace(experiment.data, **{option: value})
    with pytest.raises(InputError, match=rf"--data\.{option.replace('_', '-')} 0; give 1 or more"):
        check_settings(replace(experiment, data=data), 1)


def test_a_batch_and_a_run_of_nothing_are_refused(experiment: Experiment):
    empty = replace(experiment, train=replace(experiment.train, batch_size=0))
    with pytest.raises(InputError, match=r"--train\.batch-size 0"):
        check_settings(empty, 1)
    short = replace(experiment, optimizer=replace(experiment.optimizer, steps=0))
    with pytest.raises(InputError, match=r"--optimizer\.steps 0"):
        check_settings(short, 1)


def test_a_stereo_model_is_not_trained_on_single_views(experiment: Experiment):
    data = replace(experiment.data, num_views=1, references=1)
    with pytest.raises(InputError, match=r"tiny looks at 2 photos or more, and --data\.num-views"):
        check_settings(replace(experiment, data=data), 1)
    check_settings(replace(experiment, data=data, model=ModelConfig("tiny_semantic")), 1)


def test_a_depth_range_that_ends_before_it_begins_is_refused(experiment: Experiment):
    data = replace(experiment.data, depth_range=(5.0, 0.1))
    with pytest.raises(InputError, match=r"the depth range 5 0\.1 is not one"):
        check_settings(replace(experiment, data=data), 1)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"pose_noise": (0.0, -0.1)}, r"pose-noise -0\.1; give 0 or more"),
        ({"color_jitter": float("nan")}, "color-jitter nan; give 0 or more"),
        ({"views_part": 0.0}, "views-part 0: give a share"),
        ({"views_part": -1.0}, "views-part -1: give a share"),
        ({"least_pose_noise_share": 1.5}, r"least-pose-noise-share 1\.5: give a share"),
        ({"farthest": (7.0, 4.0)}, "farthest 7 4; give the nearer first"),
        ({"farthest": (0.05, 0.08)}, r"farthest 0\.05 0\.08; .* beyond 0\.1 m"),
    ],
)
def test_augmentation_that_is_none_is_refused(experiment: Experiment, settings: dict, reason: str):
    with pytest.raises(InputError, match=reason):
        check_settings(replace(experiment, data=replace(experiment.data, **settings)), 1)


def test_cached_features_are_of_pictures_that_come_again(experiment: Experiment):
    cached = replace(experiment, model=replace(experiment.model, feature_cache="cache"))
    check_settings(cached, 1)
    with pytest.raises(InputError, match="feature-cache keeps features of pictures"):
        check_settings(replace(cached, data=replace(cached.data, views_part=0.5)), 1)


def test_stages_are_checkpointed_where_there_are_any(experiment: Experiment):
    cascade = cascade_of(build("tiny"), experiment)
    assert not cascade.checkpoint_stages
    with pytest.raises(InputError, match=r"leave --train\.checkpoint-stages out"):
        cascade_of(build("tiny_semantic"), experiment)


def test_scenes_without_truth_teach_nothing(experiment: Experiment, tmp_path: Path):
    write_posed_folder(tmp_path / "room", 3, depth=False, labels=False)
    with pytest.raises(InputError, match=r"no depth maps .* and no labels .* tiny learns from"):
        check_truth(experiment)


def test_scenes_with_half_of_the_truth_teach_that_half(
    experiment: Experiment, tmp_path: Path, caplog
):
    write_posed_folder(tmp_path / "room", 3, labels=False)
    with caplog.at_level(logging.WARNING, "mvsam"):
        check_truth(experiment)
    assert "has no labels (labels/): it teaches the rest alone" in caplog.text
    with pytest.raises(InputError, match="no labels"):
        check_truth(replace(experiment, model=ModelConfig("tiny_sam_semantic")))
    check_truth(replace(experiment, model=ModelConfig("cas_mvsnet")))


def test_a_model_that_reads_depth_needs_it_in_every_sample(experiment: Experiment, tmp_path: Path):
    reading = replace(experiment, model=ModelConfig("tiny_semantic"))
    with pytest.raises(InputError, match=r"leave --data\.references at 1"):
        check_truth(reading)
    write_posed_folder(tmp_path / "room", 3, depth=False)
    alone = replace(reading, data=replace(reading.data, references=1))
    with pytest.raises(InputError, match=r"reads measured depth, and .* has none"):
        check_truth(alone)
