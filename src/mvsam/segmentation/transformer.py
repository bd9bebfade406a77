"""The two-way transformer of Figure 4 (SAM's): class tokens and image cells attend both ways."""

import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Float
from torch import Tensor, nn


class Attention(nn.Module):
    """Multi-head attention whose inner width may be smaller than the outer one."""

    def __init__(self, channels: int, num_heads: int, downsample: int = 1):
        super().__init__()
        inner = channels // downsample
        self.num_heads = num_heads
        self.query = nn.Linear(channels, inner)
        self.key = nn.Linear(channels, inner)
        self.value = nn.Linear(channels, inner)
        self.out = nn.Linear(inner, channels)

    def forward(
        self,
        query: Float[Tensor, "batch queries channel"],
        key: Float[Tensor, "batch keys channel"],
        value: Float[Tensor, "batch keys channel"],
    ) -> Float[Tensor, "batch queries channel"]:
        heads = "batch token (head channel) -> batch head token channel"
        query, key, value = (
            rearrange(x, heads, head=self.num_heads)
            for x in (self.query(query), self.key(key), self.value(value))
        )
        attended = F.scaled_dot_product_attention(query, key, value)
        return self.out(
            rearrange(attended, "batch head token channel -> batch token (head channel)")
        )


class TwoWayBlock(nn.Module):
    """Self-attention, tokens to image, MLP, image to tokens; residual and norm after each."""

    def __init__(self, channels: int, num_heads: int, mlp_channels: int, is_first: bool):
        super().__init__()
        self.is_first = is_first
        self.self_attention = Attention(channels, num_heads)
        self.norm1 = nn.LayerNorm(channels)
        self.tokens_to_image = Attention(channels, num_heads, downsample=2)
        self.norm2 = nn.LayerNorm(channels)
        self.mlp = nn.Sequential(
            nn.Linear(channels, mlp_channels), nn.ReLU(), nn.Linear(mlp_channels, channels)
        )
        self.norm3 = nn.LayerNorm(channels)
        self.image_to_tokens = Attention(channels, num_heads, downsample=2)
        self.norm4 = nn.LayerNorm(channels)

    def forward(
        self,
        tokens: Float[Tensor, "batch token channel"],
        image: Float[Tensor, "batch cell channel"],
        token_position: Float[Tensor, "batch token channel"],
        image_position: Float[Tensor, "1 cell channel"],
    ) -> tuple[Float[Tensor, "batch token channel"], Float[Tensor, "batch cell channel"]]:
        if self.is_first:  # as SAM: nothing to add to yet, the output replaces the tokens
            tokens = self.self_attention(tokens, tokens, tokens)
        else:
            placed = tokens + token_position
            tokens = tokens + self.self_attention(placed, placed, tokens)
        tokens = self.norm1(tokens)
        placed, placed_image = tokens + token_position, image + image_position
        tokens = self.norm2(tokens + self.tokens_to_image(placed, placed_image, image))
        tokens = self.norm3(tokens + self.mlp(tokens))
        placed = tokens + token_position
        image = self.norm4(image + self.image_to_tokens(placed_image, placed, tokens))
        return tokens, image


class TwoWayTransformer(nn.Module):
    """Two such blocks, then a last look of the tokens at the image."""

    def __init__(
        self, channels: int = 256, num_heads: int = 8, mlp_channels: int = 2048, depth: int = 2
    ):
        super().__init__()
        self.blocks = nn.ModuleList(
            TwoWayBlock(channels, num_heads, mlp_channels, is_first=index == 0)
            for index in range(depth)
        )
        self.tokens_to_image = Attention(channels, num_heads, downsample=2)
        self.norm = nn.LayerNorm(channels)

    def forward(
        self,
        tokens: Float[Tensor, "batch token channel"],
        image: Float[Tensor, "batch cell channel"],
        image_position: Float[Tensor, "1 cell channel"],
    ) -> tuple[Float[Tensor, "batch token channel"], Float[Tensor, "batch cell channel"]]:
        """The initial tokens serve as the tokens' position at every attention."""
        position = tokens
        for block in self.blocks:
            tokens, image = block(tokens, image, position, image_position)
        last_look = self.tokens_to_image(tokens + position, image + image_position, image)
        return self.norm(tokens + last_look), image
