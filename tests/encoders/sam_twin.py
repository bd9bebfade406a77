"""The image encoder of the `segment-anything` package with the weights of ours."""

from functools import partial

import torch
from segment_anything.modeling.image_encoder import ImageEncoderViT
from timm.models.vision_transformer_sam import VisionTransformerSAM
from torch import nn

from tests.small import SIDE


def original_encoder(full_size: bool = False) -> ImageEncoderViT:
    """SAM's class at the size of `small_backbone`, or as ViT-B."""
    sizes = {
        "img_size": SIDE,
        "embed_dim": 24,
        "depth": 4,
        "num_heads": 2,
        "window_size": 3,
        "global_attn_indexes": (1, 3),
    }
    if full_size:
        sizes = {"window_size": 14, "global_attn_indexes": (2, 5, 8, 11)}
    return ImageEncoderViT(
        use_rel_pos=True,
        norm_layer=partial(nn.LayerNorm, eps=1e-6),  # pyright: ignore[reportArgumentType]
        **sizes,
    ).eval()


def randomize(module: nn.Module, seed: int = 0) -> None:
    """Positions begin at zero; here they have to matter."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, parameter in module.named_parameters():
            if "pos" in name:
                parameter.normal_(0, 0.3, generator=generator)


def copy_weights(original: nn.Module, ours: VisionTransformerSAM) -> None:
    """By the one renaming there is between the two."""
    state = {k.replace("mlp.lin", "mlp.fc"): v for k, v in original.state_dict().items()}
    ours.load_state_dict(state)
