import pytest

from mvsam.apps.bench import BoxClock, Case, every_reference, run_case, synthetic_views
from mvsam.build import MODELS
from tests.small import small_model

SMALL = Case("cas_mvsnet", "float32", width=64, height=64, repeats=1)


def test_a_case_in_a_process_of_its_own_reports_every_box_and_its_memory():
    measured = run_case(SMALL)
    assert measured.case == SMALL
    assert set(measured.stages) == {"geometry_encoder", "cascade"}
    assert 0 < sum(measured.stages.values()) <= measured.seconds
    assert measured.peak_mib >= measured.libraries_mib > 50


def test_all_references_share_one_pass_of_the_encoders():
    model, calls = small_model("tiny").eval(), {"semantic_encoder": 0, "bridge": 0, "cascade": 0}
    for box in calls:

        def count(*_, box=box):
            calls[box] += 1

        getattr(model, box).register_forward_hook(count)
    views = synthetic_views(Case("tiny", "float32", num_views=4, width=64, height=64))
    every_reference(model, views)
    assert calls == {"semantic_encoder": 1, "bridge": 1, "cascade": 4}


def test_the_clock_counts_each_box_once_a_call():
    model = small_model("tiny").eval()
    clock = BoxClock(model)
    model(synthetic_views(Case("tiny", "float32", width=64, height=64)))
    assert set(clock.seconds) == {
        "semantic_encoder",
        "geometry_encoder",
        "bridge",
        "cascade",
        "prompt",
        "decoder",
    }


@pytest.mark.parametrize("name", MODELS)
def test_views_bring_measured_depth_where_the_model_reads_it(name: str):
    views = synthetic_views(Case(name, "float32", width=64, height=64))
    assert (views.measured_depth is not None) == ("measured depth" in MODELS[name].inputs)
