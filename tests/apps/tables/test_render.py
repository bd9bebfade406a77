import csv
import io
import json
from dataclasses import asdict
from pathlib import Path

import pytest

from mvsam.apps.tables.contents import Line, lines_of
from mvsam.apps.tables.render import as_csv, as_json, as_markdown, measured_text, print_text
from mvsam.errors import InputError
from mvsam.experiments.runs import BUDGETS
from mvsam.experiments.tables import TABLES
from tests.experiments.made_up import write_seeds

ROOMS = BUDGETS["rooms"]
TABLE = TABLES[1]


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """CasMVSNet with three seeds, MVS2D not trained enough, speed of one; all else missing."""
    write_seeds(tmp_path / "runs", ROOMS["cas_mvsnet"], abs=[0.2, 0.3, 0.4], rel=[0.1, 0.1, 0.1])
    write_seeds(tmp_path / "runs", ROOMS["mvs2d"], 600, abs=[0.5], rel=[0.25])
    speed = {"model": "mvs2d", "views": 3, "seconds": 0.25, "device": "a processor"}
    speed |= {"threads": 2, "precision": "bfloat16"}
    methods = [speed | {"working_mib": 100.0, "weights_mib": 60.0}]
    (tmp_path / "speed.json").write_text(json.dumps({"methods": methods}))
    return tmp_path


@pytest.fixture
def lines(results: Path) -> dict[str, Line]:
    return {line.row.run: line for line in lines_of(TABLE, "rooms", results)}


def test_a_row_is_missing_short_or_has_its_full_budget(lines: dict[str, Line]):
    assert lines["base"].state == "missing"
    assert lines["mvs2d"].state == "not converged, no claim (600 of 4,800 pictures)"
    assert lines["cas_mvsnet"].state == "full budget"


def test_scores_without_a_claim_stand_in_brackets_and_deviations_behind(lines: dict[str, Line]):
    assert measured_text(lines["cas_mvsnet"], "abs") == "30.0 +- 10.0"
    assert measured_text(lines["mvs2d"], "abs") == "(50.0)"
    assert measured_text(lines["base"], "abs") == "-"
    assert measured_text(lines["cas_mvsnet"], "miou") == "-"


def test_results_of_one_budget_do_not_stand_in_the_other(results: Path):
    assert all(line.measured is None for line in lines_of(TABLE, "scannet", results))


def test_text_has_every_method_the_data_and_the_protocol(lines: dict[str, Line], capsys):
    print_text(TABLE, "rooms", list(lines.values()))
    text = capsys.readouterr().out
    words = " ".join(text.split())
    for row in TABLE.rows:
        assert row.method in text
    assert "rooms:test:0-60, protocol half; trained on rooms:train:10000-10800" in words
    assert "nothing is to be concluded" in words and "from scratch" in words


def test_a_narrow_terminal_gets_the_scores_and_is_told_of_the_rest(
    lines: dict[str, Line], capsys, monkeypatch
):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "100")
    print_text(TABLE, "rooms", list(lines.values()))
    text = capsys.readouterr().out
    assert "30.0 +- 10.0" in text and "not converged" in text and "cas_mvsnet" in text
    assert "parameters" not in text and "Some columns are left out" in text


def test_markdown_is_a_grid_of_as_many_cells_a_line(lines: dict[str, Line]):
    grid = [x for x in as_markdown(TABLE, "rooms", list(lines.values())).splitlines() if "|" in x]
    assert len({line.count("|") for line in grid}) == 1 and len(grid) == 2 + len(TABLE.rows)
    cas = next(line for line in grid if "CasMVSNet" in line)
    assert (
        "| 10.0 | 30.0 +- 10.0 | 6.0 | 10.0 +- 0.0 | 400 | 0 1 2 | from scratch | 934,304 |" in cas
    )


def test_csv_holds_metres_and_fractions_and_nothing_where_there_is_nothing(lines: dict[str, Line]):
    rows = list(csv.DictReader(io.StringIO(as_csv(TABLE, list(lines.values())))))
    by_run = {row["run"]: row for row in rows}
    cas = by_run["cas_mvsnet_rooms"]
    assert (float(cas["published_abs"]), float(cas["measured_abs"])) == (0.1, pytest.approx(0.3))
    assert float(cas["deviation_abs"]) == pytest.approx(0.1) and cas["seeds"] == "0 1 2"
    assert by_run["base_rooms"]["measured_abs"] == "" and by_run["mvs2d_rooms"]["seconds"] == "0.25"
    assert by_run["mvs2d_rooms"]["mib"] == "160.0"


def test_json_says_what_every_figure_rests_on(lines: dict[str, Line]):
    table = json.loads(json.dumps(as_json(TABLE, "rooms", list(lines.values()))))
    assert (table["table"], table["budget"]) == (1, "rooms")
    mvs2d = next(row for row in table["rows"] if row["run"] == "mvs2d_rooms")
    assert mvs2d["measured"] == {"abs": 0.5, "rel": 0.25}
    assert mvs2d["deviation"] == {"abs": None, "rel": None}
    assert (mvs2d["steps"], mvs2d["pictures"], mvs2d["enough_pictures"]) == (50, 600, 4800)
    assert (mvs2d["data"], mvs2d["protocol"]) == ("rooms:test:0-60", "half")
    assert (mvs2d["speed_device"], mvs2d["parameters"]) == ("a processor, 2 threads", 14_852_849)


def test_without_any_result_every_row_is_missing(tmp_path: Path):
    for number, table in TABLES.items():
        lines = lines_of(table, "scannet", tmp_path)
        assert [line.state for line in lines] == ["missing"] * len(table.rows), number
        assert all(line.parameters for line in lines)


def test_a_broken_file_of_speeds_is_refused_by_name(results: Path):
    (results / "speed.json").write_text("[]")
    with pytest.raises(InputError, match=r"speed\.json holds no speeds"):
        lines_of(TABLE, "rooms", results)


def test_a_line_keeps_the_row_as_published(lines: dict[str, Line]):
    assert asdict(lines["base"].row)["published"] == {"abs": 0.09, "rel": 0.056}
