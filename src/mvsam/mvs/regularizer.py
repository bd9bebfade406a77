"""The 3D U-Net that turns a cost volume into one score per hypothesis (CasMVSNet's, Sec. 3.2)."""

from collections.abc import Callable
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor, nn


class Conv3d(nn.Conv3d):
    """A 3D convolution that steps around wrong gradients of bfloat16 on CPUs.

    oneDNN's bfloat16 backward pass returns garbage for volumes of two planes on AVX-512 and
    corrupts memory for wide ones of eight planes on AMX (torch 2.13 to 2.14, docs/log.md). Such
    volumes are convolved in float32 while training; elsewhere this is `nn.Conv3d`.
    """

    def forward(
        self, volume: Float[Tensor, "batch _channel _plane _height _width"]
    ) -> Float[Tensor, "batch _channels _planes _rows _columns"]:
        return _in_safe_precision(super().forward, volume)


class ConvTranspose3d(nn.ConvTranspose3d):
    """The same for the transposed convolution, whose forward pass is a convolution's backward."""

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, volume: Float[Tensor, "batch _channel _plane _height _width"]
    ) -> Float[Tensor, "batch _channels _planes _rows _columns"]:
        return _in_safe_precision(super().forward, volume)


def _in_safe_precision(convolve: Callable[[Tensor], Tensor], volume: Tensor) -> Tensor:
    is_risky = (
        volume.device.type == "cpu"
        and torch.is_grad_enabled()
        and volume.shape[2] < _fewest_bfloat16_planes()
    )
    if not is_risky:
        return convolve(volume)
    with torch.autocast("cpu", enabled=False):
        return convolve(volume.float()).to(volume.dtype)


@cache
def _fewest_bfloat16_planes() -> int:
    return 9 if torch.cpu._is_amx_tile_supported() else 3


def conv3d_bn_relu(in_channels: int, out_channels: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        Conv3d(in_channels, out_channels, 3, stride, padding=1, bias=False),
        nn.BatchNorm3d(out_channels),
        nn.ReLU(inplace=True),
    )


def deconv3d_bn_relu(in_channels: int, out_channels: int) -> nn.Sequential:
    """Twice the size on all three axes."""
    return nn.Sequential(
        ConvTranspose3d(in_channels, out_channels, 3, 2, padding=1, output_padding=1, bias=False),
        nn.BatchNorm3d(out_channels),
        nn.ReLU(inplace=True),
    )


class CostRegularizer(nn.Module):
    """Three strides down, three up, sums at the skips; `base` channels at the top.

    Planes, height and width must be divisible by 8.
    """

    def __init__(self, in_channels: int, base: int = 8):
        super().__init__()
        self.entry = conv3d_bn_relu(in_channels, base)
        self.down1 = nn.Sequential(
            conv3d_bn_relu(base, 2 * base, stride=2), conv3d_bn_relu(2 * base, 2 * base)
        )
        self.down2 = nn.Sequential(
            conv3d_bn_relu(2 * base, 4 * base, stride=2), conv3d_bn_relu(4 * base, 4 * base)
        )
        self.down3 = nn.Sequential(
            conv3d_bn_relu(4 * base, 8 * base, stride=2), conv3d_bn_relu(8 * base, 8 * base)
        )
        self.up2 = deconv3d_bn_relu(8 * base, 4 * base)
        self.up1 = deconv3d_bn_relu(4 * base, 2 * base)
        self.up0 = deconv3d_bn_relu(2 * base, base)
        self.score = Conv3d(base, 1, 3, padding=1, bias=False)

    def forward(
        self, volume: Float[Tensor, "batch channel plane height width"]
    ) -> Float[Tensor, "batch plane height width"]:
        """Scores before the softmax over planes."""
        level0 = self.entry(volume)
        level1 = self.down1(level0)
        level2 = self.down2(level1)
        x = self.up2(self.down3(level2)) + level2
        x = self.up1(x) + level1
        x = self.up0(x) + level0
        return self.score(x)[:, 0]
