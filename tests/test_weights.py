import dataclasses
import json
import pickle
from pathlib import Path

import huggingface_hub
import pytest
import torch
from huggingface_hub.errors import LocalEntryNotFoundError
from segment_anything.modeling import MaskDecoder, PromptEncoder, Sam
from segment_anything.modeling.transformer import TwoWayTransformer

from mvsam import weights
from mvsam.build import MODELS
from mvsam.errors import InputError
from mvsam.model import MultiViewSAM
from mvsam.segmentation.decoder import SemanticDecoder
from mvsam.weights import WeightsInfo, load_into, load_sam, read_tensors, save
from tests.encoders.sam_twin import original_encoder, randomize
from tests.small import random_views, shuffle_statistics, small_model


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """`load` builds the small models."""
    monkeypatch.setattr(
        weights, "build", lambda name, classes, **options: small_model(name, classes, **options)
    )


def trained(name: str = "cas_mvsnet", num_classes: int = 20) -> MultiViewSAM:
    model = small_model(name, num_classes, seed=7).eval()
    shuffle_statistics(model)
    return model


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    save(trained(), tmp_path / "cas.safetensors", "cas_mvsnet")
    return tmp_path / "cas.safetensors"


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


def test_an_unknown_name_lists_the_models_and_the_nearest():
    with pytest.raises(InputError, match=r"unknown model 'tinny'\. Did you mean 'tiny'\?") as error:
        weights.load("tinny")
    assert all(name in str(error.value) for name in MODELS)


def test_a_model_without_embedded_weights_says_how_to_get_some():
    with pytest.raises(InputError, match=r"'base' has no embedded weights.*mvsam train"):
        weights.load("base")


def test_a_hub_id_is_downloaded(saved: Path, tmp_path: Path, monkeypatch):
    hub = tmp_path / "hub"
    save(trained(), hub / weights.HUB_WEIGHTS, "cas_mvsnet")
    asked = []

    def download(repository: str, name: str) -> str:
        asked.append((repository, name))
        return str(hub / name)

    monkeypatch.setattr(huggingface_hub, "hf_hub_download", download)
    assert weights.load("someone/rooms-cas").info.model == "cas_mvsnet"  # pyright: ignore
    names = (weights.HUB_WEIGHTS, weights.HUB_PAGE)
    assert asked == [("someone/rooms-cas", name) for name in names]


def test_an_unreachable_hub_says_which_files_to_fetch(monkeypatch):
    def download(repository: str, name: str) -> str:
        raise LocalEntryNotFoundError("offline")

    monkeypatch.setattr(huggingface_hub, "hf_hub_download", download)
    with pytest.raises(InputError, match=r"someone/model: .*download model\.safetensors and"):
        weights.load("someone/model")


def test_pushing_an_unfinished_run_names_what_is_missing(tmp_path: Path):
    with pytest.raises(InputError, match=r"model\.safetensors is missing"):
        weights.push_to_hub(tmp_path, "someone/model")


def test_pushing_uploads_weights_and_page_alone(tmp_path: Path, monkeypatch):
    save(trained(), tmp_path / weights.HUB_WEIGHTS, "cas_mvsnet")
    calls = {}

    class Api:
        def create_repo(self, repository, **options):
            calls["created"] = repository

        def upload_folder(self, **options):
            calls.update(options)
            return "page"

    monkeypatch.setattr(huggingface_hub, "HfApi", Api)
    assert weights.push_to_hub(tmp_path, "someone/model") == "page"
    assert calls["created"] == calls["repo_id"] == "someone/model"
    assert calls["allow_patterns"] == [weights.HUB_WEIGHTS, weights.HUB_PAGE]


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


class _Runs:
    """Unpickling this writes a file."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.mark.parametrize("suffix", [".pth", ".ckpt"])
@pytest.mark.parametrize("write", [torch.save, lambda x, p: p.write_bytes(pickle.dumps(x, 2))])
def test_a_file_that_would_run_code_is_refused_and_does_not(tmp_path: Path, suffix: str, write):
    path, touched = tmp_path / f"evil{suffix}", tmp_path / "touched"
    write({"weight": torch.ones(1), "more": _Runs(touched)}, path)
    with pytest.raises(InputError, match="holds more than numbers"):
        read_tensors(path)
    assert not touched.exists()


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04rest", b"\x80\x02."])
def test_a_pth_that_is_none_is_refused(tmp_path: Path, content: bytes):
    path = tmp_path / "broken.pth"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"broken\.pth: not a readable weights file"):
        read_tensors(path)


def test_a_truncated_pth_is_refused(tmp_path: Path):
    path = tmp_path / "cut.pth"
    torch.save(trained().state_dict(), path)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(InputError, match="not a readable weights file"):
        read_tensors(path)


@pytest.fixture
def released() -> dict[str, torch.Tensor]:
    """What SAM's `.pth` holds, with a small encoder."""
    torch.manual_seed(3)
    encoder = original_encoder()
    randomize(encoder)
    transformer = TwoWayTransformer(depth=2, embedding_dim=256, num_heads=8, mlp_dim=2048)
    sam = Sam(
        encoder,
        PromptEncoder(256, (4, 4), (64, 64), mask_in_chans=16),
        MaskDecoder(transformer_dim=256, transformer=transformer),
    )
    return sam.state_dict()


@pytest.mark.parametrize("name", ["base", "sam_semantic", "sam_conv", "mvs_sam"])
def test_sam_s_own_file_loads_every_encoder_key(name: str, released, tmp_path: Path):
    torch.save(released, tmp_path / "sam.pth")
    model = small_model(name).eval()
    load_sam(model, tmp_path / "sam.pth")
    original = original_encoder()
    prefix = "image_encoder."
    original.load_state_dict(
        {k.removeprefix(prefix): v for k, v in released.items() if k.startswith(prefix)}
    )
    images = torch.randn(1, 3, 64, 64)
    assert model.semantic_encoder is not None
    with torch.no_grad():
        ours = model.semantic_encoder.backbone.forward_features(images)
        torch.testing.assert_close(ours, original(images), atol=1e-5, rtol=0)


def test_sam_s_position_matrix_goes_to_the_decoder(released, tmp_path: Path):
    torch.save(released, tmp_path / "sam.pth")
    model = small_model("base")
    load_sam(model, tmp_path / "sam.pth")
    matrix = released["prompt_encoder.pe_layer.positional_encoding_gaussian_matrix"]
    assert torch.equal(model.state_dict()["decoder.position.gaussian"], matrix)


def test_sam_s_prompt_encoder_and_mask_decoder_are_ignored(released, tmp_path: Path):
    model = small_model("base")
    before = {k: v.clone() for k, v in model.state_dict().items()}
    torch.save(released, tmp_path / "sam.pth")
    load_sam(model, tmp_path / "sam.pth")
    changed = {k for k, v in model.state_dict().items() if not torch.equal(v, before[k])}
    starts = ("semantic_encoder.backbone.", "decoder.position.gaussian")
    assert changed and all(key.startswith(starts) for key in changed)


def test_sam_s_decoder_is_a_start_when_asked_for(released, tmp_path: Path):
    torch.save(released, tmp_path / "sam.pth")
    model = small_model("base")
    load_sam(model, tmp_path / "sam.pth", include_decoder=True)
    original = TwoWayTransformer(depth=2, embedding_dim=256, num_heads=8, mlp_dim=2048)
    prefix = "mask_decoder.transformer."
    original.load_state_dict(
        {k.removeprefix(prefix): v for k, v in released.items() if k.startswith(prefix)}
    )
    image, position = torch.randn(1, 256, 4, 4), torch.randn(1, 256, 4, 4)
    tokens = torch.randn(1, 3, 256)
    decoder = model.decoder
    assert isinstance(decoder, SemanticDecoder)
    cells = (x.flatten(2).mT.contiguous() for x in (image, position))
    with torch.no_grad():
        ours, expected = decoder.transformer(tokens, *cells), original(image, position, tokens)
    for a, b in zip(ours, expected, strict=True):
        torch.testing.assert_close(a, b, atol=1e-4, rtol=1e-4)
    last = "mask_decoder.output_upscaling.3.weight"
    assert torch.equal(decoder.state_dict()["upscaling.3.weight"], released[last])


def test_a_model_without_transformer_takes_no_decoder_of_sam_s(released, tmp_path: Path):
    torch.save(released, tmp_path / "sam.pth")
    with pytest.raises(InputError, match="no transformer decoder"):
        load_sam(small_model("sam_conv"), tmp_path / "sam.pth", include_decoder=True)


def missing(state):
    del state["image_encoder.neck.0.weight"]


def misshapen(state):
    state["image_encoder.pos_embed"] = torch.zeros(1, 5, 5, 24)


def unknown(state):
    state["image_encoder.extra"] = torch.zeros(1)


@pytest.mark.parametrize(
    "change, message",
    [
        (missing, r"1 missing \(first: neck\.0\.weight\)"),
        (misshapen, r"1 of another shape \(first: pos_embed\)"),
        (unknown, r"1 unknown \(first: extra\)"),
    ],
)
def test_a_sam_file_that_differs_is_refused(released, tmp_path: Path, change, message: str):
    change(released)
    torch.save(released, tmp_path / "sam.pth")
    with pytest.raises(InputError, match=message):
        load_sam(small_model("base"), tmp_path / "sam.pth")


def test_a_sam_file_without_the_position_matrix_is_refused(released, tmp_path: Path):
    del released["prompt_encoder.pe_layer.positional_encoding_gaussian_matrix"]
    torch.save(released, tmp_path / "sam.pth")
    with pytest.raises(InputError, match="positional matrix"):
        load_sam(small_model("base"), tmp_path / "sam.pth")


def test_a_missing_sam_file_says_which_to_fetch(tmp_path: Path):
    with pytest.raises(InputError, match=r"fetch sam_vit_b_01ec64\.pth"):
        load_sam(small_model("base"), tmp_path / "none.pth")


def test_a_model_without_sam_takes_no_sam_file(tmp_path: Path):
    with pytest.raises(InputError, match="no SAM encoder"):
        load_sam(small_model("cas_mvsnet"), tmp_path / "none.pth")


@pytest.mark.slow
def test_a_full_size_sam_file_loads(tmp_path: Path):
    from mvsam.build import build

    encoder = original_encoder(full_size=True)
    matrix = {"prompt_encoder.pe_layer.positional_encoding_gaussian_matrix": torch.randn(2, 128)}
    state = {f"image_encoder.{k}": v for k, v in encoder.state_dict().items()} | matrix
    torch.save(state, tmp_path / "sam.pth")
    model = build("sam_semantic")
    load_sam(model, tmp_path / "sam.pth")
    own = model.state_dict()["semantic_encoder.backbone.blocks.11.mlp.fc2.weight"]
    assert torch.equal(own, state["image_encoder.blocks.11.mlp.lin2.weight"])


def test_a_folder_without_weights_is_not_looked_for_on_the_hub(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("runs/unfinished").mkdir(parents=True)
    with pytest.raises(InputError, match=r"runs/unfinished holds no model\.safetensors"):
        weights.locate("runs/unfinished")
