import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mvsam.data.formats import open_scene
from mvsam.errors import InputError
from mvsam.inference.outputs import OutputFolder
from mvsam.inference.scene import predict_scene
from mvsam.types import Scene
from tests.inference.fake_model import FakeModel
from tests.synthetic import write_posed_folder

NAMES = ["0000", "0001", "0002", "0003"]


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    write_posed_folder(tmp_path / "room", 4, (128, 96))
    return open_scene(tmp_path / "room")


def read(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.asarray(picture)


def maps_of(out: Path) -> dict[str, np.ndarray]:
    kinds = ("depth", "confidence", "labels")
    kinds = (*kinds, *(f"own/{kind}" for kind in kinds))
    return {f"{kind}/{name}": read(out / kind / f"{name}.png") for kind in kinds for name in NAMES}


def assert_same(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> None:
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name], err_msg=name)


def test_depth_heeds_the_other_photos_and_the_own_maps_stay(scene, tmp_path: Path):
    predict_scene(FakeModel(), scene, tmp_path / "alone", fuse=False)
    predict_scene(FakeModel(), scene, tmp_path / "fused")
    assert not (tmp_path / "alone" / "own").exists()
    fused = maps_of(tmp_path / "fused")
    for name in NAMES:
        for kind in ("depth", "confidence"):
            alone = read(tmp_path / "alone" / kind / f"{name}.png")
            np.testing.assert_array_equal(fused[f"own/{kind}/{name}"], alone)
            assert (fused[f"{kind}/{name}"] != alone).any()
    run = json.loads((tmp_path / "fused" / "run.json").read_text())
    assert run["is_fused"] and run["seconds"]["fuse"] > 0


def test_photos_that_come_later_change_the_earlier_ones_as_if_all_came_at_once(
    scene, tmp_path: Path
):
    for references in (["0001"], ["0000", "0001"], None):
        predict_scene(FakeModel(), scene, tmp_path / "slowly", references=references)
    predict_scene(FakeModel(), scene, tmp_path / "at once")
    assert_same(maps_of(tmp_path / "slowly"), maps_of(tmp_path / "at once"))


def test_a_photo_alone_stays_as_it_is(scene, tmp_path: Path):
    predict_scene(FakeModel(), scene, tmp_path / "out", references=["0001"])
    assert not (tmp_path / "out" / "own").exists()
    assert (read(tmp_path / "out" / "confidence" / "0001.png") == 191).all()


def test_after_an_interruption_it_ends_with_the_same_maps(scene, tmp_path: Path, monkeypatch):
    def stop_at_the_third(self: OutputFolder, name: str, *rest):
        if name == NAMES[2]:
            raise KeyboardInterrupt
        write(self, name, *rest)

    write = OutputFolder.write_better
    monkeypatch.setattr(OutputFolder, "write_better", stop_at_the_third)
    with pytest.raises(KeyboardInterrupt):
        predict_scene(FakeModel(), scene, tmp_path / "stopped")
    monkeypatch.undo()
    model = FakeModel()
    predict_scene(model, scene, tmp_path / "stopped")
    assert not model.decoded  # photo by photo all was done
    predict_scene(FakeModel(), scene, tmp_path / "at once")
    assert_same(maps_of(tmp_path / "stopped"), maps_of(tmp_path / "at once"))


def test_what_is_fused_is_not_fused_again(scene, tmp_path: Path):
    out = tmp_path / "out"
    predict_scene(FakeModel(), scene, out)
    before = (out / "depth" / "0001.png").stat().st_mtime_ns
    predict_scene(FakeModel(), scene, out)
    assert (out / "depth" / "0001.png").stat().st_mtime_ns == before


def test_a_photo_predicted_anew_forgets_its_earlier_own_maps(scene, tmp_path: Path):
    out = tmp_path / "out"
    predict_scene(FakeModel(), scene, out)
    before = maps_of(out)
    Image.fromarray(np.full((96, 128), 9, np.uint8)).save(out / "own" / "confidence" / "0002.png")
    (out / "labels" / "0002.png").unlink()
    predict_scene(FakeModel(), scene, out)
    assert_same(maps_of(out), before)


def test_a_folder_is_either_fused_or_not(scene, tmp_path: Path):
    predict_scene(FakeModel(), scene, tmp_path / "out", fuse=False)
    with pytest.raises(InputError, match=r"differ in --alone.*--overwrite"):
        predict_scene(FakeModel(), scene, tmp_path / "out")
    predict_scene(FakeModel(), scene, tmp_path / "out", overwrite=True)
    assert (tmp_path / "out" / "own" / "depth" / "0003.png").is_file()
