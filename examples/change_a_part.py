"""An assembly of your own: another transformer depth, and no bridge from SAM to the cascade.

    python examples/change_a_part.py --depth 3

A model is made by handing built parts to `MultiViewSAM`; a part that is left out is None.
src/mvsam/assemblies/ holds the paper's own.
"""

import argparse

import torch

import mvsam
from mvsam.assemblies.tiny import TINY_CHANNELS, TINY_SIDE, tiny_vit
from mvsam.encoders.fpn import FeaturePyramid
from mvsam.encoders.sam import SamEncoder
from mvsam.model import MultiViewSAM
from mvsam.mvs.cascade import DepthCascade
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.segmentation.decoder import SemanticDecoder
from mvsam.segmentation.prompts import DepthPrompt
from mvsam.segmentation.transformer import TwoWayTransformer


def my_model(depth: int, num_classes: int = 20) -> MultiViewSAM:
    """Depth from geometry alone prompts a decoder of `depth` two-way blocks."""
    transformer = TwoWayTransformer(TINY_CHANNELS, num_heads=4, mlp_channels=512, depth=depth)
    return MultiViewSAM(
        geometry_encoder=FeaturePyramid(),
        semantic_encoder=SamEncoder(tiny_vit(), input_side=TINY_SIDE, tuned_blocks=None),
        cascade=DepthCascade([CostRegularizer(channels) for channels in (32, 16, 8)]),
        prompt=DepthPrompt(TINY_CHANNELS),
        decoder=SemanticDecoder(num_classes, transformer, TINY_CHANNELS),
    )


def random_views(num_views: int, width: int, height: int) -> mvsam.Views:
    """Noise, seen by cameras that stand 10 cm apart."""
    poses = torch.eye(4).repeat(1, num_views, 1, 1)
    poses[0, :, 0, 3] = 0.1 * torch.arange(num_views)
    camera = torch.tensor([[0.9 * width, 0, width / 2], [0, 0.9 * width, height / 2], [0, 0, 1]])
    images = torch.rand(1, num_views, 3, height, width)
    return mvsam.Views(images, camera.repeat(1, num_views, 1, 1), poses, torch.tensor([[0.1, 5.0]]))


def main() -> None:
    parser = argparse.ArgumentParser(description="Run an assembly of your own on random views.")
    parser.add_argument("--depth", type=int, default=3, help="two-way blocks; the paper has 2")
    parser.add_argument("--size", type=int, nargs=2, default=(320, 256), help="multiples of 32")
    arguments = parser.parse_args()
    model = my_model(arguments.depth).eval()
    with torch.inference_mode():
        prediction = model(random_views(3, *arguments.size))
    assert prediction.depth is not None and prediction.logits is not None
    print(f"depth {tuple(prediction.depth.shape)}, logits {tuple(prediction.logits.shape)}")


if __name__ == "__main__":
    main()
