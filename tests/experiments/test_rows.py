"""The rows of the tables as runs, under both budgets."""

from dataclasses import replace

import pytest
import torch

from mvsam.build import build, count_parameters
from mvsam.experiments.driver import initial_model
from mvsam.experiments.rows import TRIPLETS, RowRun, pictures_of
from mvsam.experiments.runs import BUDGETS, RUNS
from mvsam.experiments.tables import PICTURE_ROWS, TABLES
from mvsam.grid_filter import GridFilter
from mvsam.model import MultiViewSAM
from mvsam.mvs.prior import MonocularPrior
from mvsam.training.optim import make_optimizer
from tests.experiments.reduced import bare, reduced
from tests.small import random_targets, random_views

ROOMS, SCANNET = BUDGETS["rooms"], BUDGETS["scannet"]
ALL = [(budget, name) for budget, runs in BUDGETS.items() for name in runs]
DIFFERENT = [
    (budget, name)
    for budget, name in ALL
    if budget == "rooms" or SCANNET[name].experiment.model.name != ROOMS[name].experiment.model.name
]
"""Most methods are the same network with the same recipe under both budgets."""


@pytest.mark.parametrize("budget, name", ALL)
def test_every_row_builds_at_full_size_and_learns_what_is_not_frozen(budget: str, name: str):
    experiment = BUDGETS[budget][name].experiment  # pyright: ignore[reportArgumentType]
    with torch.device("meta"):
        model = initial_model(bare(experiment.model))
    optimizer, _ = make_optimizer(model, experiment.optimizer)
    learned = {id(p) for group in optimizer.param_groups for p in group["params"]}
    assert learned == {id(p) for p in model.parameters() if p.requires_grad}


def test_no_row_has_what_tiny_has_beside_the_paper():
    def parts(name: str) -> set[type]:
        with torch.device("meta"):
            return {type(module) for module in build(name).modules()}

    beside = {GridFilter, MonocularPrior}
    assert beside <= parts("tiny") and beside <= parts("tiny_semantic")
    for run in ROOMS.values():
        assert not beside & parts(run.experiment.model.name)


@pytest.mark.parametrize("budget, name", DIFFERENT)
def test_every_row_takes_a_step_that_moves_what_it_learns_alone(budget: str, name: str):
    run = BUDGETS[budget][name].experiment  # pyright: ignore[reportArgumentType]
    model = reduced(run.model)
    is_single = run.data.num_views == 1
    views = random_views(2, max(2, run.data.num_views), 64, 64, measured=is_single)
    target = random_targets(2, 64, 64, seed=0)
    config = replace(run.optimizer, steps=1)
    optimizer, _ = make_optimizer(model, config)
    before = {key: value.clone() for key, value in model.state_dict().items()}
    run.loss(model(views), target, views.depth_range)["loss"].backward()
    optimizer.step()
    learned = {key for key, p in model.named_parameters() if p.requires_grad}
    moved = {key for key, value in model.state_dict().items() if not value.equal(before[key])}
    assert len(learned & moved) > 0.5 * len(learned)  # MT-RefineNet's are too small for float32
    frozen = {key for key, p in model.named_parameters() if not p.requires_grad}
    assert not frozen & moved
    if isinstance(model, MultiViewSAM) and run.model.tuned_blocks == 0:
        assert not any(key.startswith("semantic_encoder.") for key in moved)


def test_every_row_of_the_tables_has_a_run_under_both_budgets():
    shown = {row.run for table in TABLES.values() for row in table.rows}
    assert shown == set(ROOMS) == set(SCANNET)
    assert {name for _, name in PICTURE_ROWS} <= shown
    for budget, runs in BUDGETS.items():
        for name, run in runs.items():
            assert run.experiment.name.endswith(f"_{budget}")
            assert RUNS[run.experiment.name] is run.experiment, name


def test_rooms_rows_share_data_size_and_number_of_pictures_a_step():
    for run in ROOMS.values():
        data = run.experiment.data
        assert (data.train, data.size, data.semantic_size) == (
            "rooms:train:10000-10800",
            (160, 128),
            None,
        )
        assert pictures_of(run.experiment, 1) == 12
        assert (run.scored_on, run.protocol) == ("rooms:test:0-60", "half")


def test_rows_of_small_differences_have_three_seeds_and_those_of_claims_enough_pictures():
    claims = {"cas_mvsnet", "mvs_unet", "mvs_sam", "base", "base_5_views", "base_official", "mtan"}
    claims |= {"sam_conv", "sam_frozen", "sam_tuned", "sam_tuned_gt_depth", "base_no_bridge"}
    assert {name for name, run in ROOMS.items() if len(run.seeds) == 3} == claims
    is_enough = {name: pictures_seen(run) >= run.enough for name, run in ROOMS.items()}
    once = {"unet_r34", "sam_frozen_gt_depth", "sam_tuned_gt_depth"}
    assert {name for name, enough in is_enough.items() if enough} == claims | once


def pictures_seen(run: RowRun) -> int:
    return pictures_of(run.experiment, run.experiment.optimizer.steps)


def test_ablations_on_rooms_share_the_cascade_and_the_decoder_of_tiny():
    """So that they differ by the part they are about."""

    def parts(name: str) -> MultiViewSAM:
        with torch.device("meta"):
            model = build(ROOMS[name].experiment.model.name)
        assert isinstance(model, MultiViewSAM)
        return model

    whole = parts("base")
    for name in ("cas_mvsnet", "mvs_unet", "mvs_sam", "base_no_bridge"):
        cascade = parts(name).cascade
        assert cascade is not None and whole.cascade is not None
        assert cascade.num_planes == whole.cascade.num_planes == (48, 16, 8)
        assert cascade.interval_ratios == whole.cascade.interval_ratios
    for name in ("sam_frozen", "sam_tuned", "base_no_bridge"):
        assert str(parts(name).decoder) == str(whole.decoder)


def test_parameters_of_the_scannet_rows_are_the_paper_s():
    for name, count in (("base", 94_220_588), ("mvs_sam", 90_705_504), ("cas_mvsnet", 934_304)):
        assert count_parameters(SCANNET[name].experiment.model.name) == count


def test_the_paper_s_rows_have_its_settings():
    base = SCANNET["base"].experiment
    assert base.name == "base_scannet" and base.model.tuned_blocks == 3
    assert base.optimizer.steps == TRIPLETS * 16 // 8 and base.train.batch_size == 8
    assert (base.optimizer.lr, base.optimizer.sam_lr, base.optimizer.weight_decay) == (
        1e-3,
        1e-4,
        1e-2,
    )
    assert SCANNET["mvs_sam"].experiment.model.tuned_blocks == 0
    assert SCANNET["base_5_views"].experiment.data.num_views == 5
    mvs2d = SCANNET["mvs2d"].experiment
    assert mvs2d.optimizer.steps == TRIPLETS * 30 // 64 and mvs2d.optimizer.gradient_clip == 10
    table_3 = {name for name, run in SCANNET.items() if "official" in run.scored_on}
    assert table_3 == {row.run for row in TABLES[3].rows}


def test_multi_view_rows_see_pictures_as_they_are_and_published_augmentation_is_kept():
    for name, run in ROOMS.items():
        data = run.experiment.data
        if name.startswith(("base", "cas", "mvs_", "sam", "trans")):
            assert not data.mirror and not data.color_jitter, name
        elif name != "mvs2d":
            assert data.mirror, name


def test_rare_classes_weigh_more_in_every_rooms_row_that_has_classes_and_in_no_other_budget():
    for name, run in ROOMS.items():
        if name not in ("mvs2d", "trans_mvsnet"):
            assert len(run.experiment.loss.class_weights) == 20, name  # pyright: ignore
    for name, run in SCANNET.items():
        assert getattr(run.experiment.loss, "class_weights", None) is None, name
