import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from mvsam.data.formats import open_scene
from mvsam.errors import InputError
from mvsam.inference import fusing
from mvsam.inference.outputs import OutputFolder
from mvsam.inference.scene import predict_scene
from mvsam.types import Prediction, Scene
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


def test_photos_correct_each_other_and_their_own_maps_stay(scene, tmp_path: Path):
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


def test_mistakes_of_one_photo_are_corrected(scene, tmp_path: Path):
    predict_scene(MistakenModel(), scene, tmp_path / "out")
    for index, name in enumerate(NAMES):
        truth = scene.frame(index).depth
        own, fused = (
            np.abs(read(tmp_path / "out" / kind / f"{name}.png") / 1000 / truth - 1).mean()
            for kind in ("own/depth", "depth")
        )
        assert fused < 0.7 * own
    predict_scene(FakeModel(), scene, tmp_path / "right", fuse=False)
    right = read(tmp_path / "right" / "labels" / "0001.png")
    before, after = (
        (read(tmp_path / "out" / kind / "0001.png") == right).mean()
        for kind in ("own/labels", "labels")
    )
    assert before < 0.5 and after > before + 0.3  # two others see half of the photo


class MistakenModel(FakeModel):
    """Every other depth map is too near, the others too far; the second photo's label is wrong."""

    def decode(self, *arguments: Any, **options: Any) -> Prediction:
        prediction = super().decode(*arguments, **options)
        assert prediction.depth is not None and prediction.logits is not None
        is_odd = len(self.decoded) % 2
        logits = prediction.logits.clone()
        if len(self.decoded) == 2:
            logits[:, 2] = 100
        return replace(prediction, depth=prediction.depth * (0.96, 1.04)[is_odd], logits=logits)


def test_photos_that_come_later_change_the_earlier_ones_as_if_all_came_at_once(
    scene, tmp_path: Path
):
    for references in (["0001"], ["0000", "0001"], None):
        predict_scene(FakeModel(), scene, tmp_path / "slowly", references=references)
    predict_scene(FakeModel(), scene, tmp_path / "at once")
    assert_same(maps_of(tmp_path / "slowly"), maps_of(tmp_path / "at once"))


def test_a_photo_alone_stays_as_it_is(scene, tmp_path: Path):
    predict_scene(FakeModel(), scene, tmp_path / "out", references=["0001"])
    assert (read(tmp_path / "out" / "confidence" / "0001.png") == 191).all()
    assert "is_fused" not in json.loads((tmp_path / "out" / "run.json").read_text())


def test_after_an_interruption_it_ends_with_the_same_maps(scene, tmp_path: Path, monkeypatch):
    def stop_at_the_third(self: OutputFolder, name: str, *rest):
        if name == NAMES[2]:
            raise KeyboardInterrupt
        write(self, name, *rest)

    write = OutputFolder.replace_maps
    monkeypatch.setattr(OutputFolder, "replace_maps", stop_at_the_third)
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


def test_a_photo_that_lost_a_map_is_predicted_anew(scene, tmp_path: Path):
    out = tmp_path / "out"
    predict_scene(FakeModel(), scene, out)
    before = maps_of(out)
    for lost in ("labels/0002.png", "own/depth/0003.png"):
        (out / lost).unlink()
    result = predict_scene(FakeModel(), scene, out)
    assert result.written == ["0002", "0003"]
    assert_same(maps_of(out), before)


def test_larger_photos_are_compared_thinned(scene, tmp_path: Path, monkeypatch):
    predict_scene(FakeModel(), scene, tmp_path / "fine")
    monkeypatch.setattr(fusing, "LONGEST_SIDE", 43)
    predict_scene(FakeModel(), scene, tmp_path / "thinned")
    fine, thinned = maps_of(tmp_path / "fine"), maps_of(tmp_path / "thinned")
    for name in NAMES:
        near, own = fine[f"depth/{name}"].astype(float), fine[f"own/depth/{name}"]
        far = thinned[f"depth/{name}"].astype(float)
        assert (far != own).any()
        assert np.quantile(np.abs(far / near - 1), 0.95) < 0.02


def test_float_depth_is_corrected_too_and_its_own_is_kept(scene, tmp_path: Path):
    out = tmp_path / "out"
    predict_scene(FakeModel(), scene, out, save_npz=True)
    for folder in (out, out / "own"):
        with np.load(folder / "depth" / "0001.npz") as stored:
            metres = stored["depth"]
        assert metres.dtype == np.float32
        np.testing.assert_allclose(1000 * metres, read(folder / "depth" / "0001.png"), atol=0.51)


def test_depth_beyond_what_a_png_holds_says_nothing_and_stays(scene, tmp_path: Path):
    predict_scene(FarModel(), scene, tmp_path / "out", depth_range=(0.1, 200.0), save_npz=True)
    maps = maps_of(tmp_path / "out")
    for name in NAMES:
        np.testing.assert_array_equal(maps[f"depth/{name}"], maps[f"own/depth/{name}"])


class FarModel(FakeModel):
    """Sees everything 100 m away."""

    def decode(self, *arguments: Any, **options: Any) -> Prediction:
        prediction = super().decode(*arguments, **options)
        assert prediction.depth is not None
        return replace(prediction, depth=torch.full_like(prediction.depth, 100.0))


def test_a_folder_is_either_fused_or_not(scene, tmp_path: Path):
    predict_scene(FakeModel(), scene, tmp_path / "out", fuse=False)
    with pytest.raises(InputError, match=r"--alone was chosen otherwise.*--overwrite"):
        predict_scene(FakeModel(), scene, tmp_path / "out")
    predict_scene(FakeModel(), scene, tmp_path / "out", overwrite=True)
    assert (tmp_path / "out" / "own" / "depth" / "0003.png").is_file()
    predict_scene(FakeModel(), scene, tmp_path / "out", fuse=False, overwrite=True)
    assert not (tmp_path / "out" / "own" / "depth" / "0003.png").exists()
