"""Image classifiers without their heads, each with the weights it begins from.

`imagenet` is None, `DOWNLOAD` or a file everywhere, see `load_imagenet`; the second thing returned
says which weights the network has.
"""

import timm
from jaxtyping import Float
from torch import Tensor, nn
from torchvision import models
from torchvision.models.vgg import cfgs, make_layers
from torchvision.ops import Conv2dNormActivation

from mvsam.baselines.imagenet import load_imagenet

HRNET_CHANNELS = (18, 36, 72, 144)
"""Of HRNet-W18's scales, finest first."""


def hrnet_w18_small_v2(imagenet: str | None = None) -> tuple[nn.Module, str]:
    """3,860,720 parameters; a list of features at 1/4, 1/8, 1/16, 1/32, sides divisible by 32.

    As in the release of PAD-Net and MTI-Net, branches meet through bilinear upsampling and batch
    norms have momentum 0.01; timm's own are nearest and 0.1.
    """
    network = timm.create_model(
        "hrnet_w18_small_v2", features_only=True, feature_location="", out_indices=(1, 2, 3, 4)
    )
    for module in network.modules():
        if isinstance(module, nn.Upsample):
            module.mode, module.align_corners = "bilinear", False
        elif isinstance(module, nn.BatchNorm2d):
            module.momentum = 0.01
    return network, load_imagenet(network, imagenet, _released_hrnet)


def _released_hrnet() -> dict[str, Tensor]:
    return timm.create_model("hrnet_w18_small_v2", pretrained=True).state_dict()


class DilatedResNet(nn.Module):
    """The four stages of a ResNet, the last two dilated by 2 and 4 instead of strided: 1/8.

    As torchvision builds it, the first block of each dilated stage keeps the dilation before it.
    """

    def __init__(self, network: models.ResNet):
        super().__init__()
        self.stem = nn.Sequential(network.conv1, network.bn1, network.relu, network.maxpool)
        self.stages = nn.ModuleList(
            [network.layer1, network.layer2, network.layer3, network.layer4]
        )

    def forward(
        self, images: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 2048 h8 w8"]:
        x = self.stem(images)
        for stage in self.stages:
            x = stage(x)
        return x


def resnet50(imagenet: str | None = None) -> tuple[DilatedResNet, str]:
    """23,508,032 parameters."""
    network = models.resnet50(replace_stride_with_dilation=[False, True, True])
    released = models.ResNet50_Weights.IMAGENET1K_V1.get_state_dict
    weights = load_imagenet(network, imagenet, released)
    return DilatedResNet(network), weights


def resnet101(imagenet: str | None = None) -> tuple[DilatedResNet, str]:
    """42,500,160 parameters."""
    network = models.resnet101(replace_stride_with_dilation=[False, True, True])
    released = models.ResNet101_Weights.IMAGENET1K_V1.get_state_dict
    weights = load_imagenet(network, imagenet, released)
    return DilatedResNet(network), weights


def mobilenet_v2(imagenet: str | None = None) -> tuple[nn.Sequential, str]:
    """The stem and 17 blocks of MobileNetV2, 1,812,800 parameters, down to 1/32.

    MT-RefineNet's expands in its first block too, by a 1x1 convolution of 32 channels that
    torchvision leaves out. It begins as the identity, so released weights stay what they were.
    """
    features = models.mobilenet_v2().features[:18]
    released = models.MobileNet_V2_Weights.IMAGENET1K_V1.get_state_dict
    weights = load_imagenet(features, imagenet, released, prefix="features.")
    expansion = Conv2dNormActivation(32, 32, kernel_size=1, activation_layer=nn.ReLU6)
    nn.init.dirac_(next(expansion.parameters()))
    features[1] = nn.Sequential(expansion, features[1])
    return features, weights


def vgg16(imagenet: str | None = None) -> tuple[nn.Sequential, str]:
    """The 13 convolutions of VGG-16 with batch norm, 14,723,136 parameters, down to 1/32."""
    features = make_layers(cfgs["D"], batch_norm=True)
    for module in features.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")
    released = models.VGG16_BN_Weights.IMAGENET1K_V1.get_state_dict
    return features, load_imagenet(features, imagenet, released, prefix="features.")
