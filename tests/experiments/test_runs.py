from dataclasses import replace

import pytest
import torch

from mvsam.data.dataset import make_targets, make_views
from mvsam.data.readers.posed_folder import PosedFolder
from mvsam.data.streaming.stream import TrainingSample, collate_training
from mvsam.errors import InputError
from mvsam.experiments.driver import initial_model
from mvsam.experiments.runs import BUDGETS, RUNS, find_run
from mvsam.training.module import predict_references
from mvsam.training.optim import make_optimizer
from tests.experiments.reduced import bare, reduced
from tests.small import SIDE
from tests.synthetic import write_posed_folder

ROWS = {run.experiment.name for runs in BUDGETS.values() for run in runs.values()}
OURS = sorted(set(RUNS) - ROWS)
"""Rows of the tables have tests of their own (`test_rows.py`)."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> PosedFolder:
    folder = tmp_path_factory.mktemp("data") / "room"
    write_posed_folder(folder, 3, (SIDE, SIDE))
    return PosedFolder(folder)


@pytest.mark.parametrize("name", OURS)
def test_every_run_builds_at_full_size(name: str):
    with torch.device("meta"):
        model = initial_model(bare(RUNS[name].model))
    optimizer, _ = make_optimizer(model, RUNS[name].optimizer)
    assert sum(p.numel() for group in optimizer.param_groups for p in group["params"]) > 900_000


@pytest.mark.parametrize("name", OURS)
def test_every_run_takes_one_reduced_step_that_lowers_its_loss(name: str, scene: PosedFolder):
    run = RUNS[name]
    frames = [scene.frame(index) for index in range(3)]
    views = make_views(frames, (SIDE, SIDE), run.data.depth_range)
    if run.data.references > 1:
        views = replace(views, measured_depth=None)
    targets = [make_targets(frame, (SIDE, SIDE)) for frame in frames[: run.data.references]]
    views, targets, _ = collate_training([TrainingSample(views, targets)] * 2)
    model = reduced(run.model)
    optimizer, schedule = make_optimizer(model, run.optimizer)

    def loss() -> torch.Tensor:
        predictions = predict_references(model, views, len(targets))
        parts = [
            run.loss(prediction, target, views.depth_range)["loss"]
            for prediction, target in zip(predictions, targets, strict=True)
        ]
        return torch.stack(parts).mean()

    before = loss()
    before.backward()
    optimizer.step()
    schedule.step()
    assert loss().item() < before.item()


@pytest.mark.parametrize("name", RUNS)
def test_every_run_says_what_it_is_for_and_is_filed_under_its_name(name: str):
    assert RUNS[name].name == name and RUNS[name].about
    assert RUNS[name].data.references <= RUNS[name].data.num_views


def test_ablations_differ_from_their_model_in_the_assembly_alone():
    whole = find_run("base_rooms")
    for name in ("base_no_bridge_rooms", "cas_mvsnet_rooms", "mvs_sam_rooms"):
        other = find_run(name)
        assert (other.data, other.optimizer, other.loss, other.train) == (
            whole.data,
            whole.optimizer,
            whole.loss,
            whole.train,
        )


def test_an_unknown_run_is_refused_with_the_names_there_are():
    with pytest.raises(
        InputError, match=r"unknown run 'tiny_joit'\. Did you mean 'tiny_joint'"
    ) as error:
        find_run("tiny_joit")
    assert all(name in str(error.value) for name in RUNS)
