"""TransMVSNet's Feature Matching Transformer: linear attention within and between the views."""

from math import log

import torch
from einops import rearrange
from jaxtyping import Float
from torch import Tensor, nn


class FeatureMatchingTransformer(nn.Module):
    """Self and cross attention in turn, `num_pairs` times; one stack for all views.

    The reference passes through the self attentions alone. A source view's j-th cross attention
    looks at what the reference was after its j-th self attention.
    """

    def __init__(self, channels: int, num_heads: int = 8, num_pairs: int = 4):
        super().__init__()
        self.self_layers = nn.ModuleList(_Layer(channels, num_heads) for _ in range(num_pairs))
        self.cross_layers = nn.ModuleList(_Layer(channels, num_heads) for _ in range(num_pairs))
        for parameter in self.parameters():
            if parameter.dim() > 1:
                nn.init.xavier_uniform_(parameter)

    def forward(
        self, features: Float[Tensor, "batch view channel height width"]
    ) -> Float[Tensor, "batch view channel height width"]:
        height, width = features.shape[-2:]
        features = features + sine_position(features.shape[2], height, width).to(features)
        reference, *sources = rearrange(features, "b v c h w -> v b (h w) c").unbind(0)
        references = []
        for layer in self.self_layers:
            reference = layer(reference, reference)
            references.append(reference)
        views = torch.stack([reference, *(self._source(x, references) for x in sources)])
        return rearrange(views, "v b (h w) c -> b v c h w", h=height)

    def _source(self, x: Tensor, references: list[Tensor]) -> Tensor:
        layers = zip(self.self_layers, self.cross_layers, references, strict=True)
        for self_layer, cross_layer, reference in layers:
            x = cross_layer(self_layer(x, x), reference)
        return x


class _Layer(nn.Module):
    """Linear attention to `source`, then two linear layers; a sum and a LayerNorm after each."""

    def __init__(self, channels: int, num_heads: int):
        super().__init__()
        self.num_heads = num_heads
        self.query = nn.Linear(channels, channels)
        self.key = nn.Linear(channels, channels)
        self.value = nn.Linear(channels, channels)
        self.out = nn.Linear(channels, channels)
        self.mlp = nn.Sequential(
            nn.Linear(channels, 2 * channels), nn.ReLU(), nn.Linear(2 * channels, channels)
        )
        self.norm_attention = nn.LayerNorm(channels)
        self.norm_mlp = nn.LayerNorm(channels)

    def forward(
        self,
        x: Float[Tensor, "batch pixel channel"],
        source: Float[Tensor, "batch source_pixel channel"],
    ) -> Float[Tensor, "batch pixel channel"]:
        heads = [
            rearrange(projected, "b n (heads c) -> b heads n c", heads=self.num_heads)
            for projected in (self.query(x), self.key(source), self.value(source))
        ]
        attended = rearrange(linear_attention(*heads), "b heads n c -> b n (heads c)")
        x = self.norm_attention(x + self.out(attended.to(x.dtype)))
        return self.norm_mlp(x + self.mlp(x))


def linear_attention(
    query: Float[Tensor, "batch head pixel channel"],
    key: Float[Tensor, "batch head source_pixel channel"],
    value: Float[Tensor, "batch head source_pixel channel"],
) -> Float[Tensor, "batch head pixel channel"]:
    """Attention with phi(q) phi(k) in place of exp(q k), where phi = ELU + 1.

    Katharopoulos et al., ICML 2020. In float32: the sums go over all pixels of a view.
    """
    with torch.autocast(query.device.type, enabled=False):
        query, key = (nn.functional.elu(x.float()) + 1 for x in (query, key))
        values_by_key = key.transpose(-1, -2) @ value.float()
        total = query @ key.sum(-2)[..., None]
        return (query @ values_by_key) / (total + 1e-6)


def sine_position(channels: int, height: int, width: int) -> Float[Tensor, "channel height width"]:
    """Sine and cosine of column and row, counted from 1, in turn from channel to channel."""
    index = torch.arange(channels // 4)
    frequency = torch.exp(-log(10_000.0) * 2 * index / (channels / 2))[:, None, None]
    x = frequency * torch.arange(1, width + 1)[None, None, :].expand(1, height, width)
    y = frequency * torch.arange(1, height + 1)[None, :, None].expand(1, height, width)
    waves = torch.stack([x.sin(), x.cos(), y.sin(), y.cos()], dim=1)
    return waves.flatten(0, 1)
