from pathlib import Path

import pytest
import torch
from segment_anything.modeling import MaskDecoder, PromptEncoder, Sam
from segment_anything.modeling.transformer import TwoWayTransformer

from mvsam.errors import InputError
from mvsam.segmentation.decoder import SemanticDecoder
from mvsam.weights import load_sam
from tests.encoders.sam_twin import original_encoder, randomize
from tests.small import small_model


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
