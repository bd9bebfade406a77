"""`mvsam table`; its parts are tested where they are."""

import json
from pathlib import Path

import pytest

from mvsam.cli import main
from mvsam.experiments import row_training
from mvsam.experiments.runs import BUDGETS
from tests.experiments.made_up import write_seeds


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("number", range(1, 6))
def test_every_table_is_shown_before_anything_is_trained(number: int, capsys):
    assert main(["table", str(number), "--data", "scannet", "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    assert table["table"] == number and {row["state"] for row in table["rows"]} == {"missing"}


def test_measured_rows_come_from_the_folder_of_results(here: Path, capsys):
    write_seeds(here / "mine" / "runs", BUDGETS["rooms"]["sam_conv"], miou=[0.2, 0.3])
    assert main(["table", "4", "--results", "mine", "--csv"]) == 0
    row = next(x for x in capsys.readouterr().out.splitlines() if "sam_conv_rooms" in x)
    assert ",0.272,0.25," in row and row.endswith(",full budget")


@pytest.mark.parametrize(
    "arguments, sentence",
    [
        (["1", "--csv", "--json"], "one form"),
        (["6", "--csv"], "Table 6 is a picture"),
        (["1", "--train", "--rows", "mtan"], "Table 1 has no row mtan; rows: mvs2d"),
        (["1", "--train", "--steps", "0"], "must be 1 or more"),
        (["1", "--rows", "mvs2d"], "add --train"),
        (["1", "--steps", "9"], "add --train"),
        (["1", "--accelerator", "cpu"], "add --train"),
        (["1", "--results", "nowhere"], "nowhere: no such folder"),
        (["4", "--data", "scannet", "--train", "--rows", "sam_conv"], "segment-anything"),
        (["7"], ""),
    ],
)
def test_what_cannot_be_done_ends_with_2_and_a_sentence(
    arguments: list[str], sentence: str, capsys
):
    assert main(["table", *arguments]) == 2
    assert sentence in " ".join(capsys.readouterr().err.split())


def test_only_the_chosen_rows_are_trained_for_as_long_as_asked(monkeypatch, capsys):
    trained: list[tuple[str, int]] = []

    def note(job: row_training.Job, *_) -> None:
        trained.append((job.name, job.steps))

    monkeypatch.setattr(row_training, "train_and_score", note)
    options = ["--train", "--rows", "cas_mvsnet", "--steps", "9", "--seeds", "2"]
    assert main(["table", "5", *options, "--markdown"]) == 0
    assert trained == [("cas_mvsnet_rooms-0", 9), ("cas_mvsnet_rooms-1", 9)]
    output = capsys.readouterr()
    assert "row 1 of 2: cas_mvsnet_rooms-0, 9 steps" in output.err
    assert output.out.startswith("**Table 5: Model ablations**")
