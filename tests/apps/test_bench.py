"""The benchmark measures what it says it does; how fast that was is not a test."""

from dataclasses import replace
from unittest import mock

import pytest
import torch

from mvsam.apps.bench import forms
from mvsam.apps.bench.cases import Case, check_case, synthetic_targets, synthetic_views
from mvsam.apps.bench.clock import StageClock
from mvsam.apps.bench.forms import FORMS, our_model, repeat_all, share_features, textbook_model
from mvsam.apps.bench.measure import Measurement, measure, run_case
from mvsam.apps.bench.report import ratios, tables
from mvsam.apps.bench.scaling import cases_along, fit_line
from mvsam.build import MODELS, Inputs
from mvsam.commands.bench import Bench
from mvsam.errors import InputError
from tests.small import small_model

SMALL = Case("cas_mvsnet", width=64, height=64, repeats=1)


@pytest.fixture
def small_models(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(forms, "build", small_model)


def test_a_case_in_a_process_of_its_own_reports_every_box_and_its_memory():
    measured = run_case(SMALL)
    assert measured.case == SMALL
    regularizers = {f"cascade.regularizers.{stage}" for stage in range(3)}
    assert set(measured.stages) == {"geometry_encoder", "cascade"} | regularizers
    boxes = measured.stages["geometry_encoder"] + measured.stages["cascade"]
    assert 0 < boxes <= measured.seconds
    assert sum(measured.stages[name] for name in regularizers) < measured.stages["cascade"]
    # 934,304 parameters of four bytes, less what folding the batch norms saves.
    assert 3.55 < measured.weights_mib < 3.6
    assert measured.working_mib > 0
    assert measured.libraries_mib > 50


def test_a_training_step_moves_the_weights_and_is_timed_in_three_phases(small_models):
    case = replace(SMALL, work="train")
    moved = []

    def prepare(case: Case):
        moved.append(our_model(case))
        return moved[0]

    with mock.patch.dict(FORMS, {"ours": replace(FORMS["ours"], prepare=prepare)}):
        measured = measure(case)
    assert set(measured.stages) == {"forward", "backward", "optimizer"}
    before = dict(small_model("cas_mvsnet").named_parameters())
    assert all((p != before[name]).any() for name, p in moved[0].named_parameters())


def test_both_forms_predict_the_same(small_models):
    case = replace(SMALL, model="tiny")
    torch.manual_seed(0)
    views = synthetic_views(case)
    ours, textbook = our_model(case), textbook_model(case)
    with torch.inference_mode():
        mine, theirs = share_features(ours, views, 3), repeat_all(textbook, views, 3)
    assert len(mine) == len(theirs) == 3
    for a, b in zip(mine, theirs, strict=True):
        # Random weights: logits of a few tenths, depths in metres.
        torch.testing.assert_close(a.depth, b.depth, atol=5e-3, rtol=0)
        torch.testing.assert_close(a.logits, b.logits, atol=5e-3, rtol=0)


@pytest.mark.parametrize("form", FORMS)
def test_a_case_may_change_the_number_of_planes(form, small_models):
    case = replace(SMALL, num_planes=(16, 8, 8))
    with torch.inference_mode():
        stages = FORMS[form].prepare(case)(synthetic_views(case)).stages
    assert [stage.hypotheses.shape[1] for stage in stages] == [16, 8, 8]


@pytest.mark.parametrize(("form", "encoded"), [("ours", 1), ("textbook", 4)])
def test_only_the_textbook_form_encodes_the_views_for_every_reference(
    form, encoded: int, small_models
):
    case = replace(SMALL, model="tiny", num_views=4)
    model, calls = FORMS[form].prepare(case), {"semantic_encoder": 0, "cascade": 0}
    for box in calls:

        def count(*_, box=box):
            calls[box] += 1

        getattr(model, box).register_forward_hook(count)
    FORMS[form].predict(model, synthetic_views(case), 4)
    assert calls == {"semantic_encoder": encoded, "cascade": 4}


def test_the_clock_adds_up_what_runs_inside_a_stage(monkeypatch: pytest.MonkeyPatch):
    ticks = iter([10.0, 13.0, 20.0, 21.0])
    monkeypatch.setattr("mvsam.apps.bench.clock.perf_counter", lambda: next(ticks))
    clock = StageClock("cpu")
    model = torch.nn.Sequential(torch.nn.Identity())
    clock.watch(model, ["0", "absent"])
    model(torch.zeros(1))
    with clock.stage("0"):
        pass
    assert clock.seconds() == {"0": 4.0}


def test_whole_calls_are_timed_by_their_median(monkeypatch: pytest.MonkeyPatch):
    ticks = iter([0.0, 9.0, 10.0, 12.0, 20.0, 23.0])
    monkeypatch.setattr("mvsam.apps.bench.clock.perf_counter", lambda: next(ticks))
    assert StageClock("cpu").median_seconds(lambda: None, repeats=3) == 3.0


def fake(form, precision, seconds: float, working: float = 100.0) -> Measurement:
    case = Case("tiny", form, precision=precision)
    stages = {"cascade": seconds / 2, "cascade.regularizers.0": seconds / 4}
    return Measurement(case, seconds, stages, working, weights_mib=4.0, libraries_mib=300.0)


def test_ratios_hold_ours_against_the_textbook_in_equal_precision_and_in_float32():
    measured = [
        fake("ours", "bfloat16", 0.5),
        fake("textbook", "bfloat16", 1.5, working=250.0),
        fake("textbook", "float32", 4.0, working=400.0),
    ]
    found = {ratio.against: ratio for ratio in ratios(measured)}
    assert set(found) == {"bfloat16", "float32"}
    assert found["bfloat16"].seconds == 3 and found["float32"].seconds == 8
    assert found["bfloat16"].working_memory == 2.5
    assert found["float32"].stages == {
        stage: 8 for stage in ("cascade", "cascade.regularizers.0", "regularizers")
    }


def test_the_table_sets_all_references_beside_one_and_ours_beside_the_textbook():
    one, textbook = fake("ours", "float32", 0.5), fake("textbook", "float32", 4.0)
    three = replace(one, case=replace(one.case, num_references=3), seconds=0.8)
    (table,) = tables([one, textbook, three])
    columns = {str(column.header): list(column.cells) for column in table.columns}
    assert columns["form"] == ["ours", "against float32", "textbook", "ours"]
    assert columns["together"] == ["0.500", "8.0x", "4.000", "0.800"]
    assert columns["of one"] == ["1.00x", "", "1.00x", "1.60x"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"models": ("tinny",)}, "Did you mean 'tiny'"),
        ({"width": 300}, "divisible by 32"),
        ({"views": 0}, "must be 1 or more"),
    ],
)
def test_what_cannot_be_measured_is_refused_before_minutes_are_spent(options, said: str):
    with pytest.raises(InputError, match=said):
        Bench(device="cpu", **options).run()


def test_the_same_precision_is_not_measured_twice():
    with mock.patch("mvsam.precision.has_native_bfloat16", return_value=False):
        cases = Bench(device="cpu").cases()
    assert {case.precision for case in cases} == {"float32"}
    assert len(cases) == len(set(cases)) == 16


def test_a_model_that_reads_measured_depth_has_one_reference():
    cases = Bench(models=("sam_semantic_gt_depth", "tiny"), views=5, device="cpu").cases()
    references = {(case.model, case.num_references) for case in cases}
    assert references == {("sam_semantic_gt_depth", 1), ("tiny", 1), ("tiny", 5)}


def test_textbook_training_in_bfloat16_is_left_out_on_a_cpu():
    bench = Bench(models=("tiny",), precisions=("bfloat16",), device="cpu")
    assert {(case.form, case.work) for case in bench.cases()} == {
        ("ours", "predict"),
        ("textbook", "predict"),
        ("ours", "train"),
    }
    with pytest.raises(InputError, match="unsound"):
        replace(bench, forms=("textbook",), work=("train",)).run()


@pytest.mark.parametrize("name", MODELS)
def test_views_bring_measured_depth_where_the_model_reads_it(name: str):
    case = replace(SMALL, model=name)
    check_case(case)
    views, targets = synthetic_views(case), synthetic_targets(case)
    assert (views.measured_depth is not None) == (MODELS[name].inputs is Inputs.RGBD)
    assert targets.depth.shape == (1, 64, 64)


def test_the_line_says_how_far_the_worst_point_is_off():
    exact = fit_line([1.0, 2.0, 3.0], [3.0, 5.0, 7.0])
    assert (exact.intercept, exact.slope) == pytest.approx((1, 2))
    assert exact.largest_deviation == pytest.approx(0, abs=1e-9)
    bent = fit_line(
        [1.0, 2.0, 3.0], [3.0, 6.0, 7.0]
    )  # the line is 4/3 + 2 x: off by 1/3 in 3, by 2/3 in 6
    assert bent.largest_deviation == pytest.approx(1 / 9)


def test_scaling_changes_one_thing_at_a_time_and_the_planes_of_every_stage_alike():
    axes = cases_along(SMALL)
    assert [case for _, case in axes["views"]] == [
        replace(SMALL, num_views=count) for count in (2, 3, 4, 6, 8)
    ]
    for place, case in axes["planes"]:
        assert case.num_planes is not None
        assert [planes / place for planes in case.num_planes] == pytest.approx([1, 2 / 3, 1 / 3])
        assert all(planes % 8 == 0 for planes in case.num_planes)
    assert all(case.width % 32 == case.height % 32 == 0 for _, case in axes["megapixels"])
