"""A scan as ScanNet gives it, .sens and label zip: `mvsam train` and `eval` take it as it is."""

import json
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from mvsam.cli import main
from tests.data.readers.sens_writer import write_label_zip, write_sens, write_tsv
from tests.experiments.small_run import drive, small_experiment
from tests.small import SIDE
from tests.synthetic import camera_intrinsics, camera_pose, render

COLOR, DEPTH = (1296, 968), (640, 480)
NUM_FRAMES = 41
CENTRES = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
RAW_OF_CLASS = np.array([1, 3] + [99] * 254)
"""Walls and floors in the raw categories of `write_tsv`, all else a lamp."""


def write_scan(path: Path) -> None:
    """41 frames of ScanNet's sizes; every 20th shows the room and all others repeat the last one.

    So each of the frames that MVS2D's rule takes is another, and rendering takes no minute.
    """
    path.mkdir(parents=True)
    poses = [camera_pose(index // 20) for index in range(NUM_FRAMES)]
    seen = {}
    for index in (0, 20, 40):
        image, _, labels = render(COLOR, camera_intrinsics(COLOR), poses[index])
        seen[index] = image, render(DEPTH, camera_intrinsics(DEPTH), poses[index])[1], labels
    images, depths, labels = zip(
        *(seen[index // 20 * 20] for index in range(NUM_FRAMES)), strict=True
    )
    write_sens(
        path / f"{path.name}.sens",
        list(images),
        list(depths),
        poses,
        camera_intrinsics(COLOR) - CENTRES,
        camera_intrinsics(DEPTH) - CENTRES,
    )
    write_label_zip(path / f"{path.name}_2d-label-filt.zip", [RAW_OF_CLASS[x] for x in labels])
    write_tsv(path.parent / "scannetv2-labels.combined.tsv")


pytestmark = pytest.mark.filterwarnings("ignore")  # Lightning's own


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """(the folder of scans, the folder of shards, weights trained on them for one step)."""
    pytest.importorskip("lightning")
    folder = tmp_path_factory.mktemp("scannet")
    write_scan(folder / "scans/scene0000_00")
    (folder / "scans/scannetv2_train.txt").write_text("scene0000_00\n")
    experiment = small_experiment(folder / "scans", 1, "auto")
    scans = f"0.5 @ {folder / 'scans/scannetv2_train.txt'} + 0.5 @ rooms:train:0-2"
    data = replace(
        experiment.data, train=scans, tuples="mvs2d", room_frames=3, cache=str(folder / "shards")
    )
    return (
        folder / "scans",
        folder / "shards",
        drive(replace(experiment, data=data), folder / "run", 1),
    )


def test_training_takes_a_raw_scan_beside_rooms_and_keeps_its_frames(trained):
    _, shards, weights = trained
    assert weights.is_file()
    (shard,) = shards.glob(f"scans-{SIDE}x{SIDE}/scene0000_00-*/*.npz")
    with np.load(shard) as kept:
        names = json.loads(kept["about"].tobytes())["frames"]
        assert [name for name, _ in names] == ["000000", "000020", "000040"]
        assert set(np.unique(kept["labels1"])) == {0, 1, 255}
        assert kept["depth1"].shape == kept["labels1"].shape == (SIDE, SIDE)


@pytest.mark.parametrize("protocol", ["paper", "mvs2d", "scannet-2d"])
def test_a_raw_scan_is_scored_under_every_protocol(trained, protocol, capsys):
    scans, _, weights = trained
    arguments = ["--data", str(scans), "--protocol", protocol, "--limit", "1", "--json"]
    with mock.patch("mvsam.assemblies.tiny.TINY_SIDE", SIDE):
        assert main(["eval", str(weights), *arguments, "--tuples", "mvs2d"]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["protocol"] == protocol and list(scores["scenes"]) == ["scene0000_00"]
    assert scores["num_images"] == 1
    assert all(scores[key] is not None for key in ("abs", "rel", "rmse", "miou", "ause"))
