"""One row from nothing to its result, at a size for tests."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from mvsam.errors import InputError
from mvsam.experiments.config import ModelConfig
from mvsam.experiments.driver import LAST, first_weights, initial_model
from mvsam.experiments.results import read_result, result_path, write_result
from mvsam.experiments.row_training import (
    Folders,
    Job,
    check_beginning,
    claim,
    is_done,
    is_left,
    jobs_of,
    train_and_score,
    train_jobs,
)
from mvsam.experiments.rows import RowRun
from mvsam.experiments.runs import BUDGETS
from mvsam.provenance import commit
from mvsam.weights import load, read_info, save
from tests.experiments.made_up import result_of
from tests.experiments.small_run import small_experiment
from tests.small import SIDE, small_model

pytestmark = pytest.mark.filterwarnings("ignore")  # Lightning's and TensorBoard's own

ROOMS = BUDGETS["rooms"]


@pytest.fixture
def job(data: Path) -> Job:
    """Two steps of CasMVSNet on 64 x 64 pixels."""
    experiment = small_experiment(data, 2, "32-true")
    experiment = replace(
        experiment, name="small", model=ModelConfig("tiny_cas_mvsnet", num_classes=None)
    )
    row = ROOMS["cas_mvsnet"].row
    run = RowRun(row, experiment, (0,), str(data), "half", views=3, enough=8)
    return Job(run, seed=1, steps=2, accelerator="cpu")


@pytest.fixture
def folders(tmp_path: Path) -> Folders:
    return Folders(tmp_path / "runs", tmp_path / "results")


def never(done: int, count: int) -> None:
    raise AssertionError("scored again")


def test_a_row_is_trained_scored_and_then_done(job: Job, folders: Folders):
    seen: list[tuple[int, int]] = []
    path = train_and_score(job, folders, lambda *place: seen.append(place), shows_training=False)
    assert path == result_path(folders.results, "small", 1)
    result = read_result(path)
    assert (result.seed, result.steps, result.pictures) == (1, 2, 2 * 2 * 2)
    assert (result.protocol, result.weights) == ("half", "random")
    assert result.scores["rel"] > 0 and result.scores["miou"] is None
    assert "scenes" not in result.scores
    assert result.train_seconds is not None and result.train_seconds > 0
    assert result.experiment["train"]["seed"] == 1 and result.trained_at == commit()
    assert seen == [(done, 5) for done in range(1, 6)]
    assert not (folders.runs / "small-1" / LAST).exists()

    said: list[str] = []
    assert is_done(job, folders)
    assert train_jobs([job], folders, said.append, never) == []
    assert said == ["1 of 1: small-1 is done"]
    assert not is_done(replace(job, steps=3), folders)


def test_a_row_whose_scoring_was_interrupted_is_scored_without_training(
    job: Job, folders: Folders, monkeypatch
):
    path = train_and_score(job, folders, shows_training=False)
    before = read_result(path).scores
    path.unlink()
    monkeypatch.setattr("mvsam.experiments.row_training.train", never)
    assert read_result(train_and_score(job, folders)).scores == before


def test_weights_of_other_batches_are_not_taken_for_those_of_the_row(job: Job, folders: Folders):
    train_and_score(job, folders, shows_training=False).unlink()
    experiment = job.run.experiment
    experiment = replace(experiment, train=replace(experiment.train, batch_size=4))
    changed = replace(job, run=replace(job.run, experiment=experiment))
    with pytest.raises(InputError, match="with other settings than the row"):
        train_and_score(changed, folders)


def test_a_row_that_another_process_is_at_is_left_to_it(job: Job, folders: Folders):
    said: list[str] = []
    with claim(job, folders) as is_ours:
        assert is_ours
        assert train_jobs([job], folders, said.append, never) == [job]
    assert said == ["1 of 1: small-1 is left to another process"]
    with claim(job, folders) as is_ours:
        assert is_ours


def test_a_row_waits_for_the_one_it_begins_with(job: Job, folders: Folders):
    row = replace(job.run.row, name="later", after=job.run.row.name)
    experiment = replace(job.run.experiment, name="later")
    later = replace(job, run=replace(job.run, row=row, experiment=experiment))
    with claim(job, folders):
        assert train_jobs([job, later], folders, lambda _: None, never) == [job, later]


def test_rows_come_once_and_after_those_they_begin_with():
    jobs = jobs_of(["mvs_unet", "unet_r34", "unet_r50"], ROOMS)
    names = [job.name for job in jobs]
    assert names == [
        "unet_r34_rooms-0",
        *(f"mvs_unet_rooms-{seed}" for seed in range(3)),
        "unet_r50_rooms-0",
    ]
    five = [job.name for job in jobs_of(["base_5_views", "base_official"], ROOMS)]
    assert five == [f"base_5_views_rooms-{seed}" for seed in range(3)]


def test_all_rows_can_have_the_same_steps_and_seeds():
    jobs = jobs_of(["segnet", "base"], ROOMS, steps=7, seeds=2)
    assert [(job.name, job.steps) for job in jobs] == [
        (f"{row}_rooms-{seed}", 7) for row in ("segnet", "base") for seed in range(2)
    ]
    assert jobs[1].experiment.optimizer.steps == 7 and jobs[1].experiment.train.seed == 1
    own = {job.name: job.steps for job in jobs_of(["segnet", "base"], ROOMS)}
    assert own == {"segnet_rooms-0": 25, **{f"base_rooms-{seed}": 400 for seed in range(3)}}


@pytest.mark.parametrize(
    "config, remedy",
    [
        (
            ModelConfig("tiny", semantic_encoder="runs/tiny/model.safetensors"),
            "train tiny",
        ),
        (ModelConfig("base", sam_checkpoint="sam_vit_b_01ec64.pth"), "segment-anything"),
        (ModelConfig("mvs_unet", init=("runs/unet_r34_rooms-0/model.safetensors",)), "mvsam table"),
    ],
)
def test_weights_that_a_row_begins_with_are_asked_for_before_anything_is_trained(
    config: ModelConfig, remedy: str, tmp_path: Path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=remedy):
        check_beginning(config)
    for path in (config.semantic_encoder, config.sam_checkpoint, *config.init):
        if path:
            Path(path).parent.mkdir(parents=True, exist_ok=True)
            Path(path).touch()
    check_beginning(config)


def test_what_a_row_began_with_is_named_in_a_word():
    semantic = ModelConfig("tiny", semantic_encoder="runs/tiny/model.safetensors")
    assert first_weights(semantic, "random") == "tiny"
    packed = first_weights(ModelConfig("tiny", semantic_encoder="tiny"), "random")
    assert packed == f"tiny {(load('tiny').weights_hash or '')[:8]}"
    assert first_weights(ModelConfig("mtan"), "random") == "random"
    assert first_weights(ModelConfig("mtan", imagenet="download"), "imagenet") == "imagenet"
    sam = ModelConfig("base", sam_checkpoint="sam_vit_b_01ec64.pth")
    assert first_weights(sam, "random") == "sam_vit_b_01ec64"


def test_the_semantic_encoder_alone_is_taken_from_other_weights(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("mvsam.assemblies.tiny.TINY_SIDE", SIDE)
    given = small_model("tiny_semantic_gt_depth", seed=5)
    path = tmp_path / "given.safetensors"
    save(given, path, "tiny_semantic_gt_depth")
    assert read_info(path.with_suffix(".json")).model == "tiny_semantic_gt_depth"
    torch.manual_seed(1)
    state = initial_model(ModelConfig("tiny_sam_semantic", semantic_encoder=str(path))).state_dict()
    same = {
        key for key, value in given.state_dict().items() if key in state and value.equal(state[key])
    }
    expected = {key for key in state if key.startswith("semantic_encoder.")}
    assert expected <= same
    assert "decoder.class_tokens" not in same
    with pytest.raises(InputError, match="no semantic encoder"):
        initial_model(ModelConfig("cas_mvsnet", semantic_encoder=str(path)))


def test_results_of_fewer_steps_are_not_enough(job: Job, folders: Folders):
    path = result_path(folders.results, "small", 1)
    path.parent.mkdir(parents=True)
    page = result_of(job.run, seed=1, pictures=12)
    path.write_text(json.dumps(page.__dict__))
    assert not is_done(job, folders)
    path.write_text(json.dumps(replace(page, steps=2).__dict__))
    assert is_done(job, folders)
    path.write_text(json.dumps(replace(page, steps=2, data="rooms:test:0-1").__dict__))
    assert not is_done(job, folders), "the row is scored on other data by now"
    decisive = [("data", "train"), ("data", "references"), ("data", "size"), ("optimizer", "lr")]
    decisive += [("train", "batch_size"), ("loss", "beta"), ("model", "tuned_blocks")]
    for part, setting in decisive:
        other = {**page.experiment, part: {**page.experiment[part], setting: "another"}}
        path.write_text(json.dumps(replace(page, steps=2, experiment=other).__dict__))
        assert not is_done(job, folders), f"{setting} of the row is another by now"
    for part, setting in (("data", "workers"), ("optimizer", "steps"), ("train", "seed")):
        other = {**page.experiment, part: {**page.experiment[part], setting: "another"}}
        path.write_text(json.dumps(replace(page, steps=2, experiment=other).__dict__))
        assert is_done(job, folders), f"{setting} says nothing of what was learned"


def note_done(job: Job, folders: Folders) -> None:
    page = replace(result_of(job.run, seed=job.seed), steps=job.steps)
    write_result(folders.results, page, "cpu")


def note_weights(job: Job, folders: Folders) -> None:
    weights = folders.weights(job.run, job.seed)
    weights.parent.mkdir(parents=True)
    weights.touch()


def test_a_row_that_is_shown_in_pictures_is_done_while_its_weights_are_there(
    job: Job, folders: Folders
):
    note_done(job, folders)
    needed = replace(job, needs_weights=True)
    assert is_done(job, folders) and not is_done(needed, folders)
    note_weights(job, folders)
    assert is_done(needed, folders)


def test_a_row_is_trained_again_for_its_weights_while_another_is_to_begin_with_them(
    job: Job, folders: Folders
):
    first = replace(job, seed=0)
    row = replace(job.run.row, name="later", after=job.run.row.name)
    experiment = replace(job.run.experiment, name="later")
    later = replace(job, run=replace(job.run, row=row, experiment=experiment))
    jobs = [first, later]
    assert is_left(first, jobs, folders)
    note_done(first, folders)
    assert is_left(first, jobs, folders), "its result is there, its weights are not"
    note_weights(first, folders)
    assert not is_left(first, jobs, folders) and is_left(later, jobs, folders)
    folders.weights(first.run, 0).unlink()
    note_done(later, folders)
    assert not is_left(first, jobs, folders), "nothing is to begin with it any more"
