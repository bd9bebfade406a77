import re

import pytest

from mvsam.build import Inputs, model_spec
from mvsam.experiments.runs import BUDGETS
from mvsam.experiments.tables import METRICS, PICTURE_SCENES, TABLES, runs_of


def test_published_figures_are_metres_and_fractions():
    rows = {row.run: row.published for row in TABLES[2].rows}
    assert rows["mtan"] == {"miou": 0.561, "abs": 0.227, "rel": 0.146, "rmse": 0.326}
    assert rows["base"] == {"miou": 0.625, "abs": 0.09, "rel": 0.056, "rmse": 0.149}


def test_a_row_that_stands_in_several_tables_has_the_same_figures_in_each():
    known: dict[tuple[str, str], float] = {}
    for table in TABLES.values():
        for row in table.rows:
            for metric, value in row.published.items():
                assert known.setdefault((row.run, metric), value) == value, (row.run, metric)
    assert len(known) == 14 + 18 + 8 + 7 + 3  # that table by table are new


@pytest.mark.parametrize("number", TABLES)
def test_a_row_publishes_the_metrics_of_its_table_that_its_model_can_have(number: int):
    table = TABLES[number]
    assert set(table.metrics) <= set(METRICS)
    for row in table.rows:
        spec = model_spec(BUDGETS["scannet"][row.run].experiment.model.name)
        tasks = {"semantics" if metric == "miou" else "depth" for metric in row.published}
        assert tasks <= set(spec.tasks), row.method
        assert set(row.published) <= set(table.metrics)
        assert (row.modality == "RGB-D") == (spec.inputs is Inputs.RGBD), row.method
        assert (row.views > 1) == (spec.inputs is Inputs.VIEWS), row.method


def test_views_of_a_row_are_those_it_is_trained_with():
    for table in TABLES.values():
        for row in table.rows:
            for runs in BUDGETS.values():
                assert runs[row.run].experiment.data.num_views == row.views, row.method


def test_tables_have_as_many_rows_as_the_paper_s():
    assert {number: len(table.rows) for number, table in TABLES.items()} == {
        1: 7,
        2: 5,
        3: 8,
        4: 8,
        5: 6,
    }
    assert runs_of(6) == ["mtan", "cas_mvsnet", "base"] and len(PICTURE_SCENES) == 6


def test_scenes_are_named_as_scannet_names_them():
    assert all(re.fullmatch(r"scene\d{4}_\d\d", name) for name in PICTURE_SCENES)
