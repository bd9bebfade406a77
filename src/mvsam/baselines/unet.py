"""U-Net (Ronneberger et al., MICCAI 2015) on a ResNet: Table 4's monocular semantics."""

from typing import Literal

from torchvision.models import get_weight

from mvsam.baselines.imagenet import load_imagenet, reference_image
from mvsam.encoders.unet import unet
from mvsam.types import Model, Prediction, Views

RELEASED = {
    "resnet34": "ResNet34_Weights.IMAGENET1K_V1",
    "resnet50": "ResNet50_Weights.IMAGENET1K_V1",
}
"""Names of torchvision's ImageNet weights."""


class UNet(Model):
    """Semantics of view 0 alone: segmentation-models-pytorch's U-Net, as it is.

    24,439,124 parameters on a ResNet-34, 32,523,860 on a ResNet-50. Trained by cross entropy.
    imagenet: weights of the encoder, see `load_imagenet`.
    """

    def __init__(
        self,
        encoder: Literal["resnet34", "resnet50"],
        num_classes: int = 20,
        imagenet: str | None = None,
    ):
        super().__init__()
        self.num_classes = num_classes
        network = unet(encoder, num_classes)
        self.encoder = network.encoder
        self.decoder = network.decoder
        self.head = network.segmentation_head
        self.backbone_weights = load_imagenet(
            network.encoder, imagenet, lambda: get_weight(RELEASED[encoder]).get_state_dict()
        )

    def forward(self, views: Views) -> Prediction:
        """Logits at the picture's size; sides must be divisible by 32."""
        features = self.encoder(reference_image(views, divisor=32))
        return Prediction(logits=self.head(self.decoder(features)).float())
