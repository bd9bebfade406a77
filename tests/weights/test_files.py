import dataclasses
import json
from pathlib import Path

import pytest
import torch

from mvsam import weights
from mvsam.errors import InputError
from mvsam.weights import WeightsInfo, load_into, read_tensors, save
from tests.small import random_views, small_model
from tests.weights.conftest import trained


@pytest.mark.parametrize("name", ["cas_mvsnet", "tiny", "base", "sam_conv"])
def test_a_saved_model_is_loaded_with_equal_weights_in_evaluation_mode(name: str, tmp_path: Path):
    model, path = trained(name), tmp_path / "new" / "model.safetensors"
    save(model, path, name)
    loaded = weights.load(str(path))
    assert not loaded.training
    state = loaded.state_dict()
    assert all(torch.equal(state[key], value) for key, value in model.state_dict().items())
    assert [p.name for p in sorted(path.parent.iterdir())] == ["model.json", "model.safetensors"]


def test_a_loaded_model_predicts_what_the_saved_one_did(saved: Path):
    views = random_views()
    with torch.no_grad():
        expected, actual = trained()(views).depth, weights.load(str(saved))(views).depth
    # Another memory layout sums in another order.
    torch.testing.assert_close(actual, expected, atol=1e-5, rtol=1e-5)


def test_half_precision_keeps_eleven_bits_in_half_the_bytes(saved: Path, tmp_path: Path):
    half = tmp_path / "half.safetensors"
    save(trained(), half, "cas_mvsnet", half=True)
    assert half.stat().st_size < 0.6 * saved.stat().st_size
    exact = trained().state_dict()
    for key, value in weights.load(str(half)).state_dict().items():
        assert value.dtype == exact[key].dtype
        torch.testing.assert_close(value, exact[key], rtol=2**-11, atol=1e-7)


def test_the_page_says_everything_about_the_weights(tmp_path: Path):
    path = tmp_path / "mine.safetensors"
    save(
        trained("tiny", num_classes=2),
        path,
        "tiny",
        depth_range=(0.2, 8.0),
        training={"run": "mine", "steps": 12},
        classes=("rock", "sand"),
        palette=((1, 2, 3), (4, 5, 6)),
    )
    assert json.loads((tmp_path / "mine.json").read_text()) == {
        "model": "tiny",
        "num_classes": 2,
        "classes": ["rock", "sand"],
        "palette": [[1, 2, 3], [4, 5, 6]],
        "depth_range": [0.2, 8.0],
        "input_size": [320, 256],
        "semantic_size": None,
        "training": {"run": "mine", "steps": 12},
    }
    info = weights.load(str(path)).info
    expected = WeightsInfo(
        model="tiny",
        num_classes=2,
        classes=("rock", "sand"),
        palette=((1, 2, 3), (4, 5, 6)),
        depth_range=(0.2, 8.0),
        training={"run": "mine", "steps": 12},
    )
    assert dataclasses.asdict(info) == dataclasses.asdict(expected)  # pyright: ignore


def test_a_loaded_model_carries_its_input_size_and_hash(saved: Path):
    model = weights.load(str(saved))
    assert model.input_size == (320, 256)
    assert model.weights_hash == weights.file_hash(saved) and len(weights.file_hash(saved)) == 16


def test_from_pretrained_is_load(saved: Path):
    assert weights.from_pretrained(str(saved)).info == weights.load(str(saved)).info


def test_a_folder_of_a_finished_run_is_taken_for_its_weights(tmp_path: Path):
    save(trained(), tmp_path / weights.HUB_WEIGHTS, "cas_mvsnet")
    assert weights.load(str(tmp_path)).info.model == "cas_mvsnet"  # pyright: ignore


@pytest.mark.parametrize("keep", [0, 4, 100, 5000])
def test_truncated_weights_are_refused(saved: Path, keep: int):
    saved.write_bytes(saved.read_bytes()[:keep])
    with pytest.raises(InputError, match=r"cas\.safetensors: not a readable weights file"):
        weights.load(str(saved))


def test_corrupt_weights_are_refused(saved: Path):
    saved.write_bytes(b"\xff" * 4096)
    with pytest.raises(InputError, match="not a readable weights file"):
        weights.load(str(saved))


def test_a_missing_file_is_named():
    with pytest.raises(InputError, match=r"nowhere/model\.safetensors: no such weights file"):
        weights.load("nowhere/model.safetensors")


def test_a_missing_page_is_named(saved: Path):
    saved.with_suffix(".json").unlink()
    with pytest.raises(InputError, match=r"cas\.json is missing: it belongs beside the weights"):
        weights.load(str(saved))


@pytest.mark.parametrize("text", ["", "[1]", "{", '{"model": "tiny", "surprise": 1}', "\udcff"])
def test_a_page_that_is_none_is_refused(saved: Path, text: str):
    saved.with_suffix(".json").write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(InputError, match=r"cas\.json is not a page of mvsam weights"):
        weights.load(str(saved))


def test_weights_of_another_model_say_what_does_not_fit(saved: Path):
    page = saved.with_suffix(".json")
    page.write_text(page.read_text().replace("cas_mvsnet", "mvs_sam"))
    with pytest.raises(InputError, match=r"does not fit this model: \d+ missing \(first: bridge"):
        weights.load(str(saved))


def test_an_unknown_name_lists_what_has_weights_and_the_nearest():
    with pytest.raises(InputError, match=r"unknown model 'tinny'\. Did you mean 'tiny'\?") as error:
        weights.load("tinny")
    assert all(name in str(error.value) for name in weights.embedded())
    with pytest.raises(InputError, match=r"Did you mean 'tiny-nyu'"):
        weights.load("tiny_nyu")


def test_a_model_without_embedded_weights_says_how_to_get_some():
    with pytest.raises(InputError, match=r"'base' has no embedded weights.*mvsam train"):
        weights.load("base")


def test_fine_tuning_with_other_classes_begins_their_tokens_anew(tmp_path: Path):
    path = tmp_path / "tiny.safetensors"
    given = trained("tiny")
    save(given, path, "tiny")
    model = small_model("tiny", num_classes=3)
    assert load_into(model, str(path)) == ["decoder.class_tokens"]
    own, expected = model.state_dict(), given.state_dict()
    assert all(torch.equal(own[k], expected[k]) for k in own if k != "decoder.class_tokens")


def test_weights_of_which_nothing_fits_are_refused(tmp_path: Path):
    torch.save({"strange": torch.ones(2)}, tmp_path / "strange.pth")
    with pytest.raises(InputError, match="none of its weights fits"):
        load_into(small_model("cas_mvsnet"), str(tmp_path / "strange.pth"))


def test_the_model_in_a_training_checkpoint_is_found(tmp_path: Path):
    model = trained()
    state = {f"model.{key}": value for key, value in model.state_dict().items()}
    checkpoint = {"state_dict": {**state, "other.x": torch.ones(1)}, "global_step": 3}
    torch.save(checkpoint, tmp_path / "last.ckpt")
    assert load_into(small_model("cas_mvsnet"), str(tmp_path / "last.ckpt")) == []
    assert set(read_tensors(tmp_path / "last.ckpt")) == set(model.state_dict())


def test_a_folder_without_weights_is_not_looked_for_on_the_hub(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("runs/unfinished").mkdir(parents=True)
    with pytest.raises(InputError, match=r"runs/unfinished holds no model\.safetensors"):
        weights.locate("runs/unfinished")


def test_the_size_of_the_photos_for_sam_goes_along_with_the_weights(tmp_path: Path):
    model = trained("tiny")
    model.semantic_size = (96, 64)
    save(model, tmp_path / "tiny.safetensors", "tiny")
    assert weights.load(str(tmp_path / "tiny.safetensors")).semantic_size == (96, 64)
