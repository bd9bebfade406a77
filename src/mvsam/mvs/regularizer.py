"""The 3D U-Net that turns a cost volume into one score per hypothesis (CasMVSNet's, Sec. 3.2)."""

from collections.abc import Callable
from functools import cache

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from mvsam import convolution_gradient
from mvsam.convolution import add, convolve_by_onednn, fits_onednn


class Conv3d(nn.Conv3d):
    """`nn.Conv3d` that steps around wrong gradients and slow code of PyTorch on CPUs (docs/log.md).

    oneDNN's bfloat16 backward pass returns garbage for volumes of two planes on AVX-512 and
    corrupts memory for wide ones of eight planes on AMX (torch 2.13 to 2.14). Such volumes are
    convolved in float32 while training. In float32 `convolution_gradient.py` serves; where it
    cannot, one volume of moderate depth would go to PyTorch's old code, tens of times slower than
    oneDNN, and more so backwards.
    """

    def forward(
        self, volume: Float[Tensor, "batch _channel _plane _height _width"]
    ) -> Float[Tensor, "batch _channels _planes _rows _columns"]:
        if convolution_gradient.fits_kernel(self, volume):
            return convolution_gradient.convolve(self, volume)
        if fits_onednn(volume):
            return convolve_by_onednn(self, volume)
        return _step_around(super().forward, volume)


class ConvTranspose3d(nn.ConvTranspose3d):
    """The same for the transposed convolution, whose forward pass is a convolution's backward."""

    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, volume: Float[Tensor, "batch _channel _plane _height _width"]
    ) -> Float[Tensor, "batch _channels _planes _rows _columns"]:
        if convolution_gradient.fits_kernel(self, volume):
            return convolution_gradient.convolve(self, volume)
        if fits_onednn(volume):
            return convolve_by_onednn(self, volume)
        return _step_around(super().forward, volume)


def _step_around(convolve: Callable[[Tensor], Tensor], volume: Tensor) -> Tensor:
    is_training = torch.is_grad_enabled() and not torch.compiler.is_compiling()
    if volume.device.type != "cpu" or not is_training:
        return convolve(volume)  # before a question that would fix the batch of an exported graph
    is_cast = torch.is_autocast_enabled("cpu")
    is_risky = is_cast and volume.shape[2] < _fewest_bfloat16_planes()
    is_slow = not is_cast and volume.dtype == torch.float32 and len(volume) == 1
    if not (is_risky or is_slow):
        return convolve(volume)
    with torch.autocast("cpu", enabled=False):
        wide = volume.float()
        if len(wide) == 1:  # a batch of two is what PyTorch leaves to oneDNN
            return convolve(torch.cat([wide, torch.zeros_like(wide)]))[:1].to(volume.dtype)
        return convolve(wide).to(volume.dtype)


class ScoreConv3d(nn.Conv3d):
    """A 3x3x3 convolution to one channel, as a 2D convolution of every plane to three.

    Their sum over neighbouring planes is the same; oneDNN pads one output channel to eight or
    more, so this way it does a third of the work.
    """

    def __init__(self, in_channels: int):
        super().__init__(in_channels, 1, 3, padding=1, bias=False)

    def forward(
        self, volume: Float[Tensor, "batch channel plane height width"]
    ) -> Float[Tensor, "batch 1 plane height width"]:
        planes = volume.transpose(1, 2)
        kernels = self.weight[0].transpose(0, 1)  # one for the plane before, at and after
        parts = F.conv2d(planes.flatten(0, 1), kernels, padding=1).unflatten(0, planes.shape[:2])
        before, at, after = F.pad(parts, (0, 0, 0, 0, 0, 0, 1, 1)).unbind(2)
        return (before[:, :-2] + at[:, 1:-1] + after[:, 2:])[:, None]


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
    score_filter: what the scores go through, planes as channels (not in the paper). Where
    planes are windows of each pixel's own it makes neighbours agree on offsets, not on depths.
    """

    def __init__(self, in_channels: int, base: int = 8, score_filter: nn.Module | None = None):
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
        self.score = ScoreConv3d(base)
        self.score_filter = score_filter or nn.Identity()

    def forward(
        self, volume: Float[Tensor, "batch channel plane height width"]
    ) -> Float[Tensor, "batch plane height width"]:
        """Scores before the softmax over planes."""
        level0 = self.entry(volume)
        level1 = self.down1(level0)
        level2 = self.down2(level1)
        x = add(self.up2(self.down3(level2)), level2)
        x = add(self.up1(x), level1)
        x = add(self.up0(x), level0)
        return self.score_filter(self.score(x)[:, 0])
