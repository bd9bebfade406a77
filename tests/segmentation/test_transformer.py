import re

import pytest
import torch
from segment_anything.modeling.transformer import TwoWayTransformer as OriginalTransformer

from mvsam.segmentation.transformer import Attention, TwoWayTransformer

NAMES = (
    (r"^layers\.", "blocks."),
    ("final_attn_token_to_image", "tokens_to_image"),
    ("norm_final_attn", "norm"),
    ("cross_attn_token_to_image", "tokens_to_image"),
    ("cross_attn_image_to_token", "image_to_tokens"),
    ("self_attn", "self_attention"),
    (r"q_proj", "query"),
    (r"k_proj", "key"),
    (r"v_proj", "value"),
    (r"out_proj", "out"),
    (r"mlp\.lin1", "mlp.0"),
    (r"mlp\.lin2", "mlp.2"),
)
"""Original name -> ours, in this order."""


def renamed(name: str) -> str:
    for pattern, ours in NAMES:
        name = re.sub(pattern, ours, name)
    return name


def test_parameters_are_those_of_sam():
    assert sum(p.numel() for p in TwoWayTransformer().parameters()) == 3_291_264


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_transformer_equals_sam_s_with_equal_weights(depth: int):
    torch.manual_seed(depth)
    original = OriginalTransformer(depth=depth, embedding_dim=32, num_heads=4, mlp_dim=48)
    ours = TwoWayTransformer(32, num_heads=4, mlp_channels=48, depth=depth)
    ours.load_state_dict({renamed(k): v for k, v in original.state_dict().items()})
    image, position = torch.randn(2, 32, 5, 7), torch.randn(1, 32, 5, 7)
    tokens = torch.randn(2, 6, 32)
    cells = (x.flatten(2).mT.contiguous() for x in (image, position))
    actual = ours(tokens, *cells)
    expected = original(image, position.expand(2, -1, -1, -1), tokens)
    for a, b in zip(actual, expected, strict=True):
        torch.testing.assert_close(a, b, atol=1e-5, rtol=0)


def test_attention_is_a_mean_when_all_keys_are_equal():
    attention = Attention(8, num_heads=2)
    value = torch.randn(1, 5, 8)
    attended = attention(torch.randn(1, 3, 8), torch.zeros(1, 5, 8), value)
    expected = attention.out(attention.value(value).mean(1, keepdim=True)).expand(-1, 3, -1)
    torch.testing.assert_close(attended, expected)
