import pytest
import torch
from segment_anything.modeling import MaskDecoder
from segment_anything.modeling.prompt_encoder import PositionEmbeddingRandom
from segment_anything.modeling.transformer import TwoWayTransformer as OriginalTransformer

from mvsam.segmentation.decoder import (
    ConvDecoder,
    PerClassQueries,
    SemanticDecoder,
    query_mlp,
    upscaling,
)
from mvsam.segmentation.transformer import TwoWayTransformer
from tests.segmentation.test_transformer import renamed


def small_decoder(num_classes: int = 5) -> SemanticDecoder:
    torch.manual_seed(0)
    transformer = TwoWayTransformer(32, num_heads=4, mlp_channels=48)
    return SemanticDecoder(num_classes, transformer, 32)


def test_full_size_decoder_has_the_specified_parameters():
    # 3,510,144 without the 256 numbers of the no-depth embedding, which the table counts apart.
    decoder = SemanticDecoder(20, TwoWayTransformer())
    assert sum(p.numel() for p in decoder.parameters()) == 3_510_144 + 256


def test_the_other_reading_of_the_queries_has_an_mlp_for_each_class():
    with torch.device("meta"):
        decoder = SemanticDecoder(20, TwoWayTransformer(), queries=PerClassQueries(20))
    assert sum(p.numel() for p in decoder.parameters()) == 6_166_496 + 256


def test_equal_mlps_for_each_class_are_one_shared_mlp():
    shared, apart = query_mlp(32), PerClassQueries(5, 32)
    for mlp in apart.mlps:
        mlp.load_state_dict(shared.state_dict())
    tokens = torch.randn(2, 5, 32)
    torch.testing.assert_close(apart(tokens), shared(tokens))


def test_conv_decoder_has_sam_s_upscaling_and_one_1_x_1_convolution():
    assert sum(p.numel() for p in ConvDecoder(20).parameters()) == 73_952 + 660


def test_upscaling_equals_sam_s_with_equal_weights():
    transformer = OriginalTransformer(depth=1, embedding_dim=32, num_heads=4, mlp_dim=8)
    original = MaskDecoder(transformer_dim=32, transformer=transformer).output_upscaling
    ours = upscaling(32)
    ours.load_state_dict(original.state_dict())
    features = torch.randn(1, 32, 4, 6)
    torch.testing.assert_close(ours(features), original(features))


def test_logits_are_sam_s_masks_of_the_class_tokens_on_a_wide_grid():
    ours = small_decoder()
    transformer = OriginalTransformer(depth=2, embedding_dim=32, num_heads=4, mlp_dim=48)
    state = {renamed(k): v for k, v in transformer.state_dict().items()}
    ours.transformer.load_state_dict(state)
    position = PositionEmbeddingRandom(16)
    ours.position.load_state_dict({"gaussian": position.positional_encoding_gaussian_matrix})
    features, embedding = torch.randn(2, 32, 4, 6), torch.randn(2, 32, 4, 6)
    tokens, cells = transformer(
        features + embedding,
        position((4, 6)).expand(2, -1, -1, -1),
        ours.class_tokens.expand(2, -1, -1),
    )
    image = ours.upscaling(cells.mT.unflatten(2, (4, 6)))
    expected = torch.einsum("bkc,bchw->bkhw", ours.queries(tokens), image)
    prompt = embedding, torch.ones(2, 1, 4, 6, dtype=torch.bool)
    torch.testing.assert_close(ours(features, prompt), expected, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("num_classes", [1, 3, 150])
@pytest.mark.parametrize("size", [(4, 4), (4, 6)])
def test_logits_come_at_four_times_the_size_for_any_number_of_classes(num_classes, size):
    features = torch.randn(2, 32, *size)
    height, width = size
    expected = (2, num_classes, 4 * height, 4 * width)
    assert small_decoder(num_classes)(features, None).shape == expected
    assert ConvDecoder(num_classes, 32)(features).shape == expected


def test_a_prompt_without_any_depth_is_no_prompt():
    decoder, features = small_decoder(), torch.randn(1, 32, 4, 4)
    prompt = torch.randn(1, 32, 4, 4), torch.zeros(1, 1, 4, 4, dtype=torch.bool)
    assert torch.equal(decoder(features, prompt), decoder(features, None))


def test_the_no_depth_embedding_learns_only_where_depth_is_missing():
    decoder, features = small_decoder(), torch.randn(1, 32, 4, 4)
    has_depth = torch.ones(1, 1, 4, 4, dtype=torch.bool)
    decoder(features, (torch.randn(1, 32, 4, 4), has_depth)).sum().backward()
    assert decoder.no_depth.grad is not None and decoder.no_depth.grad.eq(0).all()
    has_depth[..., 0] = False
    decoder(features, (torch.randn(1, 32, 4, 4), has_depth)).square().sum().backward()
    assert decoder.no_depth.grad.abs().sum() > 0


def test_exchanging_two_class_tokens_exchanges_their_maps():
    decoder, features = small_decoder(), torch.randn(1, 32, 4, 4)
    with torch.no_grad():
        before = decoder(features, None)
        decoder.class_tokens.copy_(decoder.class_tokens[[1, 0, 2, 3, 4]])
        after = decoder(features, None)
    torch.testing.assert_close(after, before[:, [1, 0, 2, 3, 4]], atol=1e-5, rtol=1e-4)
