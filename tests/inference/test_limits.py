import json
import re
from pathlib import Path

import pytest
import torch

from mvsam.data.formats import open_scene
from mvsam.errors import InputError
from mvsam.inference.limits import REMEMBERED_PHOTOS, Needs, _peak_bytes, count_needs, photos_within
from mvsam.inference.scene import predict_scene
from mvsam.memory import memory_in_use, peak_memory
from tests.inference.fake_model import FakeModel, WholeModel
from tests.small import small_model
from tests.synthetic import write_posed_folder

NEEDS = Needs(encode=40, photo=10, decode=60, pictures=5)


def test_the_peak_is_what_lives_at_the_same_time():
    given = torch.empty(1000, device="meta")

    def call() -> torch.Tensor:
        doubled = given * 2  # 4000 bytes
        both = doubled + given  # 4000 more
        del doubled
        view = both[:500]  # none of its own
        return view + 1  # 2000 beside 4000

    peak, result = _peak_bytes(call)
    assert peak == 8000 and result.shape == (500,)


def test_as_many_photos_are_remembered_as_the_limit_allows():
    assert photos_within(10**9, 100, NEEDS, 3) == REMEMBERED_PHOTOS
    assert photos_within(100 + 24 * 10 + 60 + 5, 100, NEEDS, 3) == 24
    assert photos_within(100 + 24 * 10 + 60 + 4, 100, NEEDS, 3) == 23
    assert photos_within(100 + 3 * 10 + 60 + 5, 100, NEEDS, 3) == 3


def test_a_limit_that_is_too_little_names_one_that_suffices():
    needs = Needs(encode=10**9, photo=10**7, decode=10**8, pictures=3 * 10**7)
    with pytest.raises(InputError, match="at least") as error:
        photos_within(10**9, 456 * 10**6, needs, 4)
    named = re.findall(r"([0-9.]+) GB", str(error.value))
    assert named[:2] == ["1.00", "1.53"]  # 0.456 + 4 * 0.01 + 1 + 0.03 = 1.526
    assert "0.46 of them" in str(error.value)
    assert photos_within(1_530_000_000, 456 * 10**6, needs, 4) == 4


def test_what_a_photo_leaves_behind_is_counted_exactly():
    model = small_model("tiny")
    needs = count_needs(model, (64, 32), 3, 1000)
    # Picture, pyramid of 32, 16 and 8 channels, and 128 semantic ones at a quarter, in float32.
    full, half, quarter = 64 * 32, 32 * 16, 16 * 8
    assert needs.photo == 4 * ((3 + 8) * full + 16 * half + (32 + 128) * quarter)
    assert needs.pictures == 60_000
    assert needs.encode > needs.photo and needs.decode > 3 * needs.photo
    assert all(not parameter.is_meta for parameter in model.parameters())


def test_more_views_and_larger_pictures_need_more():
    model = small_model("cas_mvsnet")
    three = count_needs(model, (64, 32), 3, 0)
    assert count_needs(model, (64, 32), 5, 0).decode > three.decode
    assert 3.5 < count_needs(model, (128, 64), 3, 0).decode / three.decode < 4.5


def test_a_model_called_as_a_whole_is_counted_as_a_whole():
    needs = count_needs(WholeModel(), (64, 48), 2, 0)
    assert needs.encode == 0 and needs.decode == 4 * 64 * 48 and needs.photo == 3 * 4 * 64 * 48


def test_what_is_in_use_is_at_most_the_peak():
    assert 10**7 < memory_in_use("cpu") <= peak_memory("cpu")


@pytest.fixture
def scene(tmp_path: Path):
    write_posed_folder(tmp_path / "room", 8, (128, 96))
    return open_scene(tmp_path / "room")


def maps_of(out: Path) -> dict[str, bytes]:
    return {str(p.relative_to(out)): p.read_bytes() for p in out.rglob("*.*") if p.stem != "run"}


def test_the_least_limit_gives_the_same_files(scene, tmp_path: Path, monkeypatch):
    free, bound = FakeModel(), FakeModel()
    predict_scene(free, scene, tmp_path / "free")
    # What else the process holds changes from moment to moment; here it is a fixed number.
    monkeypatch.setattr("mvsam.inference.scene.memory_in_use", lambda device: 5 * 10**8)
    least = 5 * 10**8 + count_needs(bound, (64, 48), 3, 128 * 96).total(3)
    bound.encoded.clear()
    predict_scene(bound, scene, tmp_path / "bound", max_memory=least)
    assert maps_of(tmp_path / "free") == maps_of(tmp_path / "bound")
    assert free.encoded_views == 8
    assert bound.encoded_views > 8 + 1  # the one that was counted on shapes
    with pytest.raises(InputError, match="is too little"):
        predict_scene(bound, scene, tmp_path / "less", max_memory=least - 1)
    assert not (tmp_path / "less").exists()


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_run_json_says_the_precision(scene, tmp_path: Path, precision):
    predict_scene(FakeModel(), scene, tmp_path / "out", references=["0000"], precision=precision)
    assert json.loads((tmp_path / "out/run.json").read_text())["precision"] == precision
