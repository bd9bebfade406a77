import json
from dataclasses import replace
from pathlib import Path

import pytest

from mvsam.errors import InputError
from mvsam.experiments.results import (
    Result,
    is_trained_as,
    read_measured,
    read_result,
    result_path,
    together,
    write_result,
)
from mvsam.experiments.runs import BUDGETS
from mvsam.provenance import commit
from tests.experiments.made_up import result_of

RUN = BUDGETS["rooms"]["cas_mvsnet"]


def test_a_result_comes_back_as_it_was_and_says_which_command_and_commit_made_it(tmp_path: Path):
    result = result_of(RUN, rel=0.1)
    path = write_result(tmp_path / "new", result, "cpu")
    assert path == result_path(tmp_path / "new", "cas_mvsnet_rooms", 0)
    assert read_result(path) == result
    page = json.loads(path.read_text())
    assert page["commit"] == commit() and {"command", "date", "device", "versions"} <= set(page)


def test_seeds_give_a_mean_and_the_deviation_of_a_sample():
    measured = together([result_of(RUN, seed, rel=rel) for seed, rel in enumerate((0.1, 0.2, 0.6))])
    assert measured.seeds == (0, 1, 2)
    assert measured.means["rel"] == pytest.approx(0.3)
    # Distances 0.2, 0.1 and 0.3 from the mean, over one less than three.
    assert measured.deviations["rel"] == pytest.approx((0.14 / 2) ** 0.5)
    assert measured.means["miou"] is None and measured.deviations["miou"] is None


def test_seeds_that_began_with_different_weights_say_so():
    results = [result_of(RUN, seed, rel=0.1) for seed in range(3)]
    began = [replace(r, weights=name) for r, name in zip(results, "aab", strict=True)]
    assert together(began).weights == "a or b"


def test_one_seed_has_no_deviation():
    measured = together([result_of(RUN, rel=0.1)])
    assert measured.means["rel"] == 0.1 and measured.deviations["rel"] is None


def test_a_row_without_results_is_not_measured(tmp_path: Path):
    write_result(tmp_path, result_of(BUDGETS["rooms"]["mtan"]), "cpu")
    assert read_measured(tmp_path, RUN) is None


def test_only_the_longest_trainings_count(tmp_path: Path):
    for seed, pictures in enumerate((24, 4800, 4800)):
        write_result(tmp_path, result_of(RUN, seed, pictures=pictures, rel=0.1 * (seed + 1)), "cpu")
    measured = read_measured(tmp_path, RUN)
    assert measured is not None and measured.seeds == (1, 2)
    assert measured.means["rel"] == pytest.approx(0.25)


@pytest.mark.parametrize("other", [{"protocol": "paper"}, {"data": "rooms:val"}, {"views": 5}])
def test_scores_under_another_protocol_are_left_out(tmp_path: Path, other: dict, caplog):
    write_result(tmp_path, replace(result_of(RUN), **other), "cpu")
    assert read_measured(tmp_path, RUN) is None
    assert "it is left out" in caplog.text


def test_a_setting_that_came_later_had_its_default(tmp_path: Path):
    recorded = RUN.experiment.as_json()
    del recorded["data"]["views_part"], recorded["train"]["parts"]
    assert is_trained_as(recorded, RUN.experiment)
    changed = replace(RUN.experiment, data=replace(RUN.experiment.data, views_part=0.5))
    assert not is_trained_as(recorded, changed)
    changed = replace(RUN.experiment, train=replace(RUN.experiment.train, parts=("decoder",)))
    assert not is_trained_as(recorded, changed)


@pytest.mark.parametrize("text", ["{", "{}", '["no"]'])
def test_a_file_that_is_no_result_is_refused_by_name(tmp_path: Path, text: str):
    path = result_path(tmp_path, RUN.experiment.name, 0)
    path.write_text(text)
    with pytest.raises(InputError, match=r"cas_mvsnet_rooms-0\.json is not the result of a row"):
        read_measured(tmp_path, RUN)


def test_a_result_without_the_scores_of_a_table_is_refused(tmp_path: Path):
    path = write_result(tmp_path, replace(result_of(RUN), scores={"rel": 0.1}), "cpu")
    with pytest.raises(InputError, match="scores"):
        read_result(path)


def test_every_field_of_a_result_is_written(tmp_path: Path):
    page = json.loads(write_result(tmp_path, result_of(RUN), "cpu").read_text())
    assert set(Result.__dataclass_fields__) <= set(page)
