"""The 3D U-Net that turns a cost volume into one score per hypothesis (CasMVSNet's, Sec. 3.2)."""

from jaxtyping import Float
from torch import Tensor, nn


def conv3d_bn_relu(in_channels: int, out_channels: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv3d(in_channels, out_channels, 3, stride, padding=1, bias=False),
        nn.BatchNorm3d(out_channels),
        nn.ReLU(inplace=True),
    )


def deconv3d_bn_relu(in_channels: int, out_channels: int) -> nn.Sequential:
    """Twice the size on all three axes."""
    return nn.Sequential(
        nn.ConvTranspose3d(
            in_channels, out_channels, 3, 2, padding=1, output_padding=1, bias=False
        ),
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
        self.score = nn.Conv3d(base, 1, 3, padding=1, bias=False)

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
