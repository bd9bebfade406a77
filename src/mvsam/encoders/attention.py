"""SAM's attention with relative positions, in pieces whose position bias stays in the cache."""

import torch
import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Float
from timm.models.vision_transformer_sam import Attention, get_rel_pos
from torch import Tensor, nn

LARGEST_BIAS = {"cpu": 2**21, "cuda": 2**27}
"""Numbers of the bias made at once while predicting. On a CPU 8 MB in float32; the whole one of a
global block of ViT-B at 1024 pixels is 805 MB, which a GPU makes in two pieces."""


class RelativeAttention(nn.Module):
    """timm's `Attention` of a SAM encoder; it takes over the layers, so weights keep their names.

    Predicting, the bias of the relative positions is made and used piece by piece (docs/log.md);
    while gradients are wanted it is made whole, as timm does.
    """

    def __init__(self, attention: Attention):
        super().__init__()
        self.num_heads = attention.num_heads
        self.rel_pos_h, self.rel_pos_w = attention.rel_pos_h, attention.rel_pos_w
        self.qkv, self.proj = attention.qkv, attention.proj
        self.fused_attn = attention.fused_attn
        """timm's name; False writes the attention out."""

    def forward(
        self, x: Float[Tensor, "windows rows columns channel"]
    ) -> Float[Tensor, "windows rows columns channel"]:
        _, rows, columns, _ = x.shape
        pattern = "b r c (three head channel) -> three (b head) (r c) channel"
        q, k, v = rearrange(self.qkv(x), pattern, three=3, head=self.num_heads).unbind(0)
        grid = rearrange(q, "b (r c) channel -> b r c channel", r=rows)
        to_rows = torch.einsum("brcd,rkd->brck", grid, get_rel_pos(rows, rows, self.rel_pos_h))
        to_columns = torch.einsum(
            "brcd,ckd->brck", grid, get_rel_pos(columns, columns, self.rel_pos_w)
        )
        if not self.fused_attn:
            scores = (q * q.shape[-1] ** -0.5) @ k.mT + whole_bias(to_rows, to_columns)
            attended = scores.softmax(dim=-1) @ v
        elif torch.is_grad_enabled():
            bias = whole_bias(to_rows, to_columns)
            attended = F.scaled_dot_product_attention(q, k, v, attn_mask=bias)
        else:
            largest = LARGEST_BIAS.get(x.device.type, LARGEST_BIAS["cpu"])
            attended = attend_in_pieces(q, k, v, to_rows, to_columns, largest)
        pattern = "(b head) (r c) channel -> b r c (head channel)"
        return self.proj(rearrange(attended, pattern, head=self.num_heads, r=rows))


def use_plain_attention(model: nn.Module) -> None:
    """Attention written out: on a CPU twice as fast forward and backward as the fused one, which
    has no fast backward with SAM's relative positions (docs/log.md)."""
    for module in model.modules():
        if isinstance(module, RelativeAttention):
            module.fused_attn = False


def whole_bias(
    to_rows: Float[Tensor, "items some_rows columns rows"],
    to_columns: Float[Tensor, "items some_rows columns columns"],
) -> Float[Tensor, "items queries keys"]:
    """What each query, of some rows of the grid, adds for the row and the column of each key."""
    return (to_rows[..., :, None] + to_columns[..., None, :]).flatten(3).flatten(1, 2)


def attend_in_pieces(
    q: Float[Tensor, "items queries channel"],
    k: Float[Tensor, "items queries channel"],
    v: Float[Tensor, "items queries channel"],
    to_rows: Float[Tensor, "items rows columns rows"],
    to_columns: Float[Tensor, "items rows columns columns"],
    largest_bias: int,
) -> Float[Tensor, "items queries channel"]:
    """`scaled_dot_product_attention` with `whole_bias`, of which `largest_bias` numbers are made
    at once: some items (heads of windows) together, or some rows of one item's queries."""
    num_items, num_queries, _ = q.shape
    rows, columns = to_rows.shape[1:3]
    items_at_once = max(1, largest_bias // num_queries**2)
    rows_at_once = max(1, min(rows, largest_bias // (items_at_once * columns * num_queries)))
    attended = torch.empty_like(v)
    for item in range(0, num_items, items_at_once):
        these = slice(item, item + items_at_once)
        for row in range(0, rows, rows_at_once):
            bias = whole_bias(
                to_rows[these, row : row + rows_at_once],
                to_columns[these, row : row + rows_at_once],
            )
            queries = slice(row * columns, (row + rows_at_once) * columns)
            # With an axis of heads: only four axes reach the fast kernels.
            attended[these, queries] = F.scaled_dot_product_attention(
                q[these, queries][None], k[these][None], v[these][None], attn_mask=bias[None]
            )[0]
    return attended
