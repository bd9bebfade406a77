import pytest
import torch
from timm.models.vision_transformer_sam import Attention

from mvsam.encoders.attention import RelativeAttention, attend_in_pieces, whole_bias
from tests.encoders.sam_twin import randomize


def attention(side: tuple[int, int] = (5, 4)) -> Attention:
    torch.manual_seed(0)
    made = Attention(24, num_heads=3, use_rel_pos=True, input_size=side)
    randomize(made)
    return made


@pytest.mark.parametrize("fused", [True, False])
@pytest.mark.parametrize("wants_gradient", [True, False])
def test_output_equals_timm_s(fused: bool, wants_gradient: bool):
    original = attention()
    ours = RelativeAttention(original)
    ours.fused_attn = fused
    x = torch.randn(2, 5, 4, 24)
    with torch.set_grad_enabled(wants_gradient):
        torch.testing.assert_close(ours(x), original(x), atol=1e-5, rtol=1e-5)


def test_weights_keep_their_names_and_places():
    original = attention()
    state = RelativeAttention(original).state_dict()
    assert set(state) == set(original.state_dict())
    assert state["qkv.weight"].data_ptr() == original.qkv.weight.data_ptr()


# 20 queries a head: 400 numbers are one head's bias, 80 are one row of it.
@pytest.mark.parametrize("largest_bias", [1, 80, 250, 400, 900, 10**6])
def test_pieces_of_any_size_make_the_whole(largest_bias: int):
    generator = torch.Generator().manual_seed(0)
    q, k, v = torch.randn(3, 7, 20, 8, generator=generator)
    to_rows = torch.randn(7, 5, 4, 5, generator=generator)
    to_columns = torch.randn(7, 5, 4, 4, generator=generator)
    scores = q @ k.mT / 8**0.5 + whole_bias(to_rows, to_columns)
    pieces = attend_in_pieces(q, k, v, to_rows, to_columns, largest_bias)
    torch.testing.assert_close(pieces, scores.softmax(-1) @ v, atol=1e-5, rtol=1e-5)


def test_the_bias_of_a_key_is_that_of_its_row_plus_that_of_its_column():
    to_rows, to_columns = torch.rand(1, 2, 3, 2), torch.rand(1, 2, 3, 3)
    bias = whole_bias(to_rows, to_columns)
    query, key = (1, 2), (0, 1)
    expected = to_rows[0, *query, key[0]] + to_columns[0, *query, key[1]]
    assert bias[0, query[0] * 3 + query[1], key[0] * 3 + key[1]] == expected
