"""MVS2D's end: the expected depth over 512 anchors at a quarter of the size, then upsampling."""

from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from mvsam.convolution import conv_bn_relu
from mvsam.geometry.camera import pixel_centres

FEATURES = 256


def inverse_depths(near: float, far: float, count: int) -> Float[Tensor, " plane"]:
    """Depths whose inverses are evenly spaced, metres; the first is the farthest."""
    return 1 / torch.linspace(1 / far, 1 / near, count)


class InverseDepthHead(nn.Module):
    """Features at a quarter of the picture in, depth at its size out."""

    def __init__(self, depth_range: tuple[float, float], num_anchors: int = 512):
        super().__init__()
        self.unet = SmallUNet()
        self.regressor = nn.Sequential(
            nn.Conv2d(FEATURES, num_anchors, 3, padding=1),
            nn.BatchNorm2d(num_anchors),
            nn.ReLU(inplace=True),
            nn.Conv2d(num_anchors, num_anchors, 1),
        )
        self.upsampler = Upsampler()
        anchors = inverse_depths(*depth_range, num_anchors)
        self.register_buffer("anchors", anchors, persistent=False)
        self.anchors: Tensor

    def forward(
        self, x: Float[Tensor, "batch channel quarter_height quarter_width"]
    ) -> Float[Tensor, "batch height width"]:
        """Metres."""
        features = self.unet(x)
        probability = torch.softmax(self.regressor(features).float(), dim=1)
        depth = (probability * self.anchors[:, None, None]).sum(1, keepdim=True)
        return self.upsampler(depth, features)[:, 0]


class SmallUNet(nn.Module):
    """Three strides down and up with sums at the skips, 64 channels in, 256 out."""

    def __init__(self, in_channels: int = 64, widths: tuple[int, ...] = (128, 64, 32, 16)):
        super().__init__()
        steps = list(pairwise(widths))
        self.entry = conv_bn_relu(in_channels, widths[0])
        self.down = nn.ModuleList(
            nn.Sequential(conv_bn_relu(wide, narrow, stride=2), conv_bn_relu(narrow, narrow))
            for wide, narrow in steps
        )
        self.up = nn.ModuleList(
            nn.Sequential(
                nn.ConvTranspose2d(narrow, wide, 3, 2, padding=1, output_padding=1, bias=False),
                nn.BatchNorm2d(wide),
                nn.ReLU(inplace=True),
            )
            for wide, narrow in reversed(steps)
        )
        self.last = nn.Conv2d(widths[0], FEATURES, 1)

    def forward(
        self, x: Float[Tensor, "batch channel height width"]
    ) -> Float[Tensor, "batch 256 height width"]:
        x = self.entry(x)
        skips = []
        for down in self.down:
            skips.append(x)
            x = down(x)
        for up in self.up:
            x = up(x) + skips.pop()
        return self.last(x)


class Upsampler(nn.Module):
    """Four times the size by the nearest pixel, plus a tenth of a learned correction."""

    def __init__(self, width: int = 16):
        super().__init__()
        self.at_quarter = nn.Sequential(
            nn.Conv2d(1 + 2 + FEATURES, width, 3, padding=1),
            nn.BatchNorm2d(width),
            nn.ReLU(inplace=True),
            nn.Conv2d(width, width, 3, padding=1),
        )
        self.at_full = nn.Sequential(
            nn.Conv2d(width, width, 3, padding=1), nn.ReLU(inplace=True), nn.Conv2d(width, 1, 1)
        )

    def forward(
        self,
        depth: Float[Tensor, "batch 1 quarter_height quarter_width"],
        features: Float[Tensor, "batch 256 quarter_height quarter_width"],
    ) -> Float[Tensor, "batch 1 height width"]:
        """Metres."""
        height, width = depth.shape[-2:]
        place = pixel_centres(height, width, device=depth.device)[..., :2].permute(2, 0, 1)
        place = place / place.new_tensor([width, height])[:, None, None]
        place = place.expand(len(depth), -1, -1, -1)
        x = self.at_quarter(torch.cat([depth, place, features], dim=1))
        correction = self.at_full(F.interpolate(x, scale_factor=4, mode="nearest"))
        return F.interpolate(depth, scale_factor=4, mode="nearest") + 0.1 * correction
