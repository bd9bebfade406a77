"""A scan as ScanNet gives it, .sens and label zip: `mvsam train` and `eval` take it as it is."""

import json
from unittest import mock

import pytest

from mvsam.cli import main
from tests.data.readers.test_scannet import write_raw
from tests.experiments.small_run import run
from tests.small import SIDE

pytestmark = pytest.mark.filterwarnings("ignore")  # Lightning's own


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """(the scan's folder, weights that were trained on it for one step)."""
    pytest.importorskip("lightning")
    folder = tmp_path_factory.mktemp("scannet")
    write_raw(folder / "scans/scene0000_00")
    return folder / "scans", run(folder / "run", folder / "scans", steps=1)


def test_training_takes_a_raw_scan(trained):
    assert trained[1].is_file()


@pytest.mark.parametrize("protocol", ["paper", "mvs2d", "scannet-2d"])
def test_a_raw_scan_is_scored_under_every_protocol(trained, protocol, capsys):
    scans, weights = trained
    arguments = ["--data", str(scans), "--protocol", protocol, "--limit", "1", "--json"]
    with mock.patch("mvsam.assemblies.tiny.TINY_SIDE", SIDE):
        assert main(["eval", str(weights), *arguments]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["protocol"] == protocol and list(scores["scenes"]) == ["scene0000_00"]
    assert scores["num_images"] == 1
    assert all(scores[key] is not None for key in ("abs", "rel", "rmse", "miou", "ause"))
