import numpy as np
import pytest
import torch
import torch.nn.functional as F
from segment_anything.modeling import Sam
from segment_anything.utils.transforms import ResizeLongestSide
from torch import nn

from mvsam.encoders.sam import ConvStem, SamEncoder, resample_valid, sam_vit_b
from mvsam.errors import InputError
from tests.encoders.sam_twin import copy_weights, original_encoder, randomize
from tests.small import SIDE, small_backbone


def small_encoder(tuned_blocks: int | None = None) -> SamEncoder:
    torch.manual_seed(0)
    encoder = SamEncoder(small_backbone(), input_side=SIDE, tuned_blocks=tuned_blocks)
    randomize(encoder)
    return encoder.eval()


def test_vit_b_has_the_parameters_of_the_released_encoder():
    with torch.device("meta"):
        assert sum(p.numel() for p in sam_vit_b().parameters()) == 89_670_912


@pytest.mark.parametrize("count", [-1, 5])
def test_tuned_blocks_that_the_encoder_does_not_have_are_refused(count: int):
    """-1 would tune all blocks but the first."""
    with pytest.raises(InputError, match=f"{count} tuned blocks of an encoder that has 4"):
        small_encoder(tuned_blocks=count)


def test_backbone_equals_the_original_encoder_with_equal_weights():
    torch.manual_seed(0)
    original, ours = original_encoder(), small_backbone().eval()
    randomize(original)
    copy_weights(original, ours)
    images = torch.randn(2, 3, SIDE, SIDE)
    with torch.no_grad():
        torch.testing.assert_close(
            ours.forward_features(images), original(images), atol=1e-5, rtol=0
        )


def test_the_encoder_s_own_attention_leaves_the_original_s_output():
    torch.manual_seed(0)
    original, ours = original_encoder(), small_backbone()
    randomize(original)
    copy_weights(original, ours)
    encoder = SamEncoder(ours, input_side=SIDE).eval()
    images = torch.rand(2, 3, SIDE, SIDE)
    with torch.no_grad():
        expected = original(encoder.prepare(images))
        torch.testing.assert_close(encoder.tokens(images), expected, atol=1e-5, rtol=0)


@pytest.mark.slow
def test_full_size_backbone_equals_the_original_encoder_with_equal_weights():
    torch.manual_seed(0)
    original, ours = original_encoder(full_size=True), sam_vit_b().eval()
    randomize(original)
    copy_weights(original, ours)
    images = torch.randn(1, 3, 1024, 1024)
    with torch.no_grad():
        expected = original(images)
        assert expected.shape == (1, 256, 64, 64)
        # Values of up to 5, so float32 itself is no finer than 5e-7.
        torch.testing.assert_close(ours.forward_features(images), expected, atol=1e-5, rtol=1e-5)


def test_sam_sees_320_x_256_at_1024_x_819():
    encoder = SamEncoder(small_backbone(), input_side=1024)
    assert encoder.inner_size(256, 320) == (819, 1024)
    assert encoder.inner_size(480, 640) == (768, 1024)
    assert encoder.inner_size(320, 256) == (1024, 819)


@pytest.mark.parametrize("size", [(48, 40), (32, 64), (64, 64), (100, 130)])
def test_input_recipe_equals_the_original_s(size):
    encoder = small_encoder()
    photo = torch.rand(1, 3, *size)
    # (The package's own `apply_image_torch` reads the size off the wrong axes.)
    inner = ResizeLongestSide.get_preprocess_shape(size[0], size[1], SIDE)
    resized = F.interpolate(
        255 * photo, inner, mode="bilinear", align_corners=False, antialias=True
    )
    sam = Sam(original_encoder(), nn.Identity(), nn.Identity())  # pyright: ignore
    # 0..255 over a deviation of 58 in float32.
    torch.testing.assert_close(encoder.prepare(photo), sam.preprocess(resized), atol=1e-4, rtol=0)


def test_features_come_at_a_quarter_of_the_picture():
    encoder = small_encoder()
    assert encoder(torch.rand(2, 3, 64, 96)).shape == (2, 256, 16, 24)
    assert encoder.channels == 256


def test_fractional_valid_rows_are_read_where_the_picture_lies():
    # Tokens that hold their own row number: 320 x 256 fills 51.1875 of 64 rows, all columns.
    rows = torch.arange(64.0)[None, None, :, None].expand(1, 1, 64, 64)
    read = resample_valid(rows, (51.1875, 64.0), (64, 80))
    expected = [min(max((row + 0.5) * 51.1875 / 64 - 0.5, 0), 51.1875 - 1) for row in range(64)]
    np.testing.assert_allclose(read[0, 0, :, 0], expected, atol=1e-4)
    columns = rows.mT.contiguous()
    read = resample_valid(columns, (51.1875, 64.0), (64, 80))
    expected = [min(max((c + 0.5) * 64 / 80 - 0.5, 0), 63) for c in range(80)]
    np.testing.assert_allclose(read[0, 0, 0], expected, atol=1e-4)


def test_padding_is_never_read():
    tokens = torch.zeros(1, 1, 8, 8)
    tokens[:, :, 6:] = 100.0
    assert resample_valid(tokens, (5.5, 8.0), (16, 16)).max() == 0


def test_a_square_grid_of_equal_size_is_returned_as_it_is():
    tokens = torch.randn(1, 3, 8, 8)
    torch.testing.assert_close(resample_valid(tokens, (8.0, 8.0), (8, 8)), tokens)


@pytest.mark.parametrize("tuned_blocks", [0, 1, 3])
def test_partly_frozen_encoder_computes_what_the_whole_does(tuned_blocks: int):
    images = torch.rand(1, 3, SIDE, SIDE)
    whole, frozen = small_encoder(None), small_encoder(tuned_blocks)
    torch.testing.assert_close(frozen(images), whole(images))


@pytest.mark.parametrize("tuned_blocks, blocks", [(0, []), (1, [3]), (3, [1, 2, 3])])
def test_only_the_last_blocks_and_the_neck_learn(tuned_blocks: int, blocks: list[int]):
    encoder = small_encoder(tuned_blocks)
    features = encoder(torch.rand(1, 3, SIDE, SIDE))
    if not tuned_blocks:
        assert not features.requires_grad
        assert not any(p.requires_grad for p in encoder.parameters())
        return
    features.square().sum().backward()
    learned = {name for name, p in encoder.named_parameters() if p.grad is not None}
    starts = (*(f"backbone.blocks.{block}." for block in blocks), "backbone.neck.")
    assert learned == {n for n, _ in encoder.named_parameters() if n.startswith(starts)}


def test_conv_stem_gives_one_token_for_16_x_16_pixels():
    stem = ConvStem(64, 16, 3, 32).eval()
    assert stem(torch.rand(2, 3, 64, 64)).shape == (2, 4, 4, 32)
    with pytest.raises(ValueError, match="16"):
        ConvStem(64, 8, 3, 32)


@pytest.mark.parametrize("tuned_blocks, moves", [(0, False), (1, False), (None, True)])
def test_a_frozen_stem_keeps_its_statistics_while_the_rest_is_trained(
    tuned_blocks: int | None, moves: bool
):
    backbone = small_backbone()
    backbone.patch_embed = ConvStem(SIDE, 16, 3, backbone.embed_dim)  # pyright: ignore
    encoder = SamEncoder(backbone, input_side=SIDE, tuned_blocks=tuned_blocks).train()
    before = {key: value.clone() for key, value in encoder.state_dict().items()}
    encoder(torch.rand(2, 3, SIDE, SIDE))
    changed = {key for key, value in encoder.state_dict().items() if not value.equal(before[key])}
    assert bool(changed) == moves
