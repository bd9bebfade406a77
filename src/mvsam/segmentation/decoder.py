"""The semantic decoder of Figure 4, and the convolutional one of Table 4 it is compared with."""

import torch
from einops import rearrange
from jaxtyping import Bool, Float
from timm.layers.norm import LayerNorm2d
from torch import Tensor, nn

from mvsam.segmentation.prompts import PositionEncoding
from mvsam.segmentation.transformer import TwoWayTransformer


def upscaling(channels: int) -> nn.Sequential:
    """Two transposed convolutions, four times the size, an eighth of the channels (SAM's)."""
    return nn.Sequential(
        nn.ConvTranspose2d(channels, channels // 4, 2, 2),
        LayerNorm2d(channels // 4),
        nn.GELU(),
        nn.ConvTranspose2d(channels // 4, channels // 8, 2, 2),
        nn.GELU(),
    )


def query_mlp(channels: int) -> nn.Sequential:
    """The MLP that turns a class token into a class query as wide as the upscaled image."""
    return nn.Sequential(
        nn.Linear(channels, channels),
        nn.ReLU(),
        nn.Linear(channels, channels),
        nn.ReLU(),
        nn.Linear(channels, channels // 8),
    )


class PerClassQueries(nn.Module):
    """An MLP for each class, as SAM has one for each of its masks."""

    def __init__(self, num_classes: int, channels: int = 256):
        super().__init__()
        self.mlps = nn.ModuleList(query_mlp(channels) for _ in range(num_classes))

    def forward(
        self, tokens: Float[Tensor, "batch num_classes channel"]
    ) -> Float[Tensor, "batch num_classes query"]:
        pairs = zip(self.mlps, tokens.unbind(dim=1), strict=True)
        return torch.stack([mlp(token) for mlp, token in pairs], dim=1)


class SemanticDecoder(nn.Module):
    """K class tokens and the prompted image talk; their dot products are the class maps.

    There is no IoU token or head: the paper has one mask a class and no choice among masks.
    queries: class tokens -> class queries; None: one `query_mlp` shared by all classes, because the
    paper says "an MLP" (Sec. 3.3). `PerClassQueries` is the other reading.
    Its `no_depth` is the learned embedding of cells without depth, SAM's device for an absent mask.
    """

    def __init__(
        self,
        num_classes: int,
        transformer: TwoWayTransformer,
        channels: int = 256,
        queries: nn.Module | None = None,
    ):
        super().__init__()
        self.num_classes = num_classes
        self.class_tokens = nn.Parameter(torch.randn(num_classes, channels))
        self.no_depth = nn.Parameter(torch.randn(channels))
        self.position = PositionEncoding(channels)
        self.transformer = transformer
        self.upscaling = upscaling(channels)
        self.queries = query_mlp(channels) if queries is None else queries

    def forward(
        self,
        features: Float[Tensor, "batch channel h4 w4"],
        prompt: tuple[Float[Tensor, "batch channel h4 w4"], Bool[Tensor, "batch 1 h4 w4"]] | None,
    ) -> Float[Tensor, "batch num_classes height width"]:
        """Logits at four times the size of the features; `prompt` as `DepthPrompt` returns it."""
        batch, _, height, width = features.shape
        no_depth = self.no_depth[:, None, None]
        dense = no_depth if prompt is None else torch.where(prompt[1], prompt[0], no_depth)
        cells = rearrange(features + dense, "b c h w -> b (h w) c")
        position = rearrange(self.position(height, width), "c h w -> 1 (h w) c")
        tokens = self.class_tokens.expand(batch, -1, -1)
        tokens, cells = self.transformer(tokens, cells, position)
        image = self.upscaling(rearrange(cells, "b (h w) c -> b c h w", h=height))
        queries = self.queries(tokens)
        masks = queries @ image.flatten(2)
        return masks.unflatten(2, image.shape[-2:])


class ConvDecoder(nn.Module):
    """Table 4's "conv decoder": the same upscaling, then one 1x1 convolution, no transformer."""

    def __init__(self, num_classes: int, channels: int = 256):
        super().__init__()
        self.num_classes = num_classes
        self.upscaling = upscaling(channels)
        self.classify = nn.Conv2d(channels // 8, num_classes, 1)

    def forward(
        self, features: Float[Tensor, "batch channel h4 w4"], prompt: None = None
    ) -> Float[Tensor, "batch num_classes height width"]:
        """Logits at four times the size of the features."""
        assert prompt is None, "the convolutional decoder takes no prompt"
        return self.classify(self.upscaling(features))
