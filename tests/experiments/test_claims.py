from pathlib import Path

import pytest

from mvsam.build import model_spec
from mvsam.experiments.claims import CLAIMS, Claim, judge
from mvsam.experiments.runs import BUDGETS
from tests.experiments.made_up import write_seeds

ROOMS = BUDGETS["rooms"]
SAM_HELPS = Claim("", "mvs_sam", "cas_mvsnet")
PROMPT_HELPS = Claim("", "base", "sam_tuned", "miou")


def write(folder: Path, pictures: int = 4800, **rows: list[float]) -> None:
    """Depth errors of rows, one a seed; labels for those without depth."""
    for name, values in rows.items():
        tasks = model_spec(ROOMS[name].experiment.model.name).tasks
        scores = {task: values for task in ("abs", "miou")} if len(tasks) == 2 else {}
        scores = scores or {"abs" if "depth" in tasks else "miou": values}
        write_seeds(folder, ROOMS[name], pictures, **scores)


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: claim.sentence)
def test_the_paper_s_own_figures_bear_out_every_claim_and_nothing_is_measured_yet(
    claim: Claim, tmp_path: Path
):
    for runs in BUDGETS.values():
        verdict = judge(claim, runs, tmp_path)
        assert verdict.published > 0
        assert verdict.measured is None and verdict.text == f"open: {claim.better} is missing"


def test_a_claim_holds_where_the_gain_exceeds_the_spread(tmp_path: Path):
    write(tmp_path, mvs_sam=[0.1, 0.1, 0.1], cas_mvsnet=[0.2, 0.3, 0.4])
    verdict = judge(SAM_HELPS, ROOMS, tmp_path)
    assert verdict.measured == pytest.approx(0.2) and verdict.spread == pytest.approx(0.1)
    assert verdict.text == "holds" and verdict.published == pytest.approx(0.007)


def test_more_is_better_of_labels_and_worse_of_errors(tmp_path: Path):
    write(tmp_path, base=[0.2, 0.2, 0.2], sam_tuned=[0.1, 0.1, 0.1])
    assert judge(PROMPT_HELPS, ROOMS, tmp_path).text == "holds"
    write(tmp_path, mtan=[0.1, 0.1, 0.1])
    assert judge(Claim("", "base", "mtan"), ROOMS, tmp_path).text == "does not hold"


def test_a_gain_within_the_spread_decides_nothing(tmp_path: Path):
    write(tmp_path, mvs_sam=[0.1, 0.2, 0.3], cas_mvsnet=[0.15, 0.25, 0.35])
    assert judge(SAM_HELPS, ROOMS, tmp_path).text.startswith("undecided")


def test_one_seed_is_said_to_be_one(tmp_path: Path):
    write(tmp_path, mvs_sam=[0.1], cas_mvsnet=[0.2])
    text = "holds, with one seed of mvs_sam and cas_mvsnet"
    assert judge(SAM_HELPS, ROOMS, tmp_path).text == text


def test_a_row_with_one_seed_is_taken_to_scatter_as_the_other(tmp_path: Path):
    write(tmp_path, mvs_sam=[0.1, 0.2, 0.3], cas_mvsnet=[0.25])
    verdict = judge(SAM_HELPS, ROOMS, tmp_path)
    assert verdict.spread == pytest.approx(0.1 * 2**0.5) and verdict.text.startswith("undecided")
    write(tmp_path, cas_mvsnet=[0.45])
    text = "undecided: within the spread of the seeds, with one seed of cas_mvsnet"
    assert judge(SAM_HELPS, ROOMS, tmp_path).text == text, "1.8 spreads, and one seed"
    write(tmp_path, cas_mvsnet=[0.5])
    assert judge(SAM_HELPS, ROOMS, tmp_path).text == "holds, with one seed of cas_mvsnet"


def test_rows_that_began_with_different_weights_are_not_compared(tmp_path: Path):
    write(tmp_path, mvs_sam=[0.1], cas_mvsnet=[0.2], base=[0.1])
    for name, began_with in (("mvs_sam", "tiny 2754a3b7"), ("base", "tiny cf820cc6")):
        path = tmp_path / f"{name}_rooms-0.json"
        path.write_text(path.read_text().replace('"random"', f'"{began_with}"'))
    assert judge(SAM_HELPS, ROOMS, tmp_path).text.startswith("holds")
    text = judge(Claim("", "base", "mvs_sam"), ROOMS, tmp_path).text
    assert text == "open: they began with different weights"


def test_rows_that_began_with_two_versions_of_their_encoder_are_not_compared(tmp_path: Path):
    write(tmp_path, mvs_sam=[0.1], base=[0.1])
    for name, digest in (("mvs_sam", "11111111"), ("base", "22222222")):
        path = tmp_path / f"{name}_rooms-0.json"
        path.write_text(path.read_text().replace('"random"', f'"rows_encoder {digest}"'))
    text = judge(Claim("", "base", "mvs_sam"), ROOMS, tmp_path).text
    assert text == "open: they began with different weights"


def test_rows_of_different_length_are_not_compared(tmp_path: Path):
    write(tmp_path, 24_000, mvs_sam=[0.1])
    write(tmp_path, cas_mvsnet=[0.2])
    text = "open: they saw different numbers of pictures"
    assert judge(SAM_HELPS, ROOMS, tmp_path).text == text


def test_rows_of_too_few_pictures_leave_a_claim_open(tmp_path: Path):
    write(tmp_path, mvs_sam=[0.1])
    write(tmp_path, 600, cas_mvsnet=[0.2])
    assert judge(SAM_HELPS, ROOMS, tmp_path).text == "open: cas_mvsnet had too few pictures"
