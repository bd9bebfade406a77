"""The decoder's prompts: where a token lies, and how deep (the dense prompt of Sec. 3.3)."""

import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from timm.layers.norm import LayerNorm2d
from torch import Tensor, nn


class PositionEncoding(nn.Module):
    """SAM's random Fourier features of the cell centres; the matrix is a buffer, not learned."""

    def __init__(self, channels: int):
        super().__init__()
        self.register_buffer("gaussian", torch.randn(2, channels // 2))
        self.gaussian: Tensor

    def forward(self, height: int, width: int) -> Float[Tensor, "channel height width"]:
        options = {"device": self.gaussian.device, "dtype": self.gaussian.dtype}
        y = (torch.arange(height, **options) + 0.5) / height
        x = (torch.arange(width, **options) + 0.5) / width
        grid = torch.stack(torch.meshgrid(y, x, indexing="ij")[::-1], dim=-1)
        signed = (2 * grid - 1)[..., None]
        # Sums, not a matmul, which autocast would round to a twentieth of a radian.
        phase = (signed * self.gaussian).sum(dim=-2) * (2 * math.pi)
        return torch.cat([phase.sin(), phase.cos()], dim=-1).permute(2, 0, 1)


DepthScale = Callable[[Tensor, Tensor, Tensor], Tensor]
"""(depth, d_min, d_max), metres -> what the prompt's first convolution sees, about -1 to 1."""


def centred_depth(depth: Tensor, near: Tensor, far: Tensor) -> Tensor:
    """-1 at d_min, 1 at d_max and beyond, evenly in depth."""
    return (2 * (depth - near) / (far - near) - 1).clamp(-1, 1)


def centred_disparity(depth: Tensor, near: Tensor, far: Tensor) -> Tensor:
    """1 at d_min and nearer, -1 at d_max and beyond, evenly in 1 / depth."""
    disparity = 1 / depth.clamp(near, far)  # clamped first: unknown depth is 0
    return 2 * (disparity - 1 / far) / (1 / near - 1 / far) - 1


class DepthPrompt(nn.Module):
    """A depth map as dense prompt: SAM's mask convolutions, one embedding per 4x4 pixels.

    The paper says "a shallow convolutional network".
    scale: the paper leaves open in which scale depth enters; we chose `centred_depth`: a
    zero-centred unit range stays visible beside the convolutions' biases.
    """

    def __init__(self, channels: int = 256, scale: DepthScale = centred_depth):
        super().__init__()
        self.scale = scale
        self.layers = nn.Sequential(
            nn.Conv2d(1, 4, 2, 2),
            LayerNorm2d(4),
            nn.GELU(),
            nn.Conv2d(4, 16, 2, 2),
            LayerNorm2d(16),
            nn.GELU(),
            nn.Conv2d(16, channels, 1),
        )

    def forward(
        self, depth: Float[Tensor, "batch height width"], depth_range: Float[Tensor, "batch 2"]
    ) -> tuple[Float[Tensor, "batch channel h4 w4"], Bool[Tensor, "batch 1 h4 w4"]]:
        """Embeddings, and the cells that have any depth at all (0 = unknown)."""
        depth, has_depth = fill_cells(depth[:, None])
        near, far = (depth_range[:, i, None, None, None] for i in (0, 1))
        return self.layers(self.scale(depth, near, far)), has_depth


CELL = 4
"""Pixels of depth, a side, that become one embedding."""


def fill_cells(
    depth: Float[Tensor, "batch 1 height width"],
) -> tuple[Float[Tensor, "batch 1 height width"], Bool[Tensor, "batch 1 h4 w4"]]:
    """Unknown pixels take the mean of the known ones of their cell; which cells have any."""
    known = depth > 0
    share = F.avg_pool2d(known.to(depth.dtype), CELL)
    mean = F.avg_pool2d(torch.where(known, depth, 0), CELL) / share.clamp(min=1e-6)
    filled = torch.where(known, depth, F.interpolate(mean, scale_factor=CELL, mode="nearest"))
    return filled, share > 0
