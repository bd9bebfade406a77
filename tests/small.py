"""Every model of `build.py` at a size for tests, and views and targets to feed it.

The assemblies are the package's own; only the SAM backbone and its input side are reduced.
"""

from functools import partial
from unittest import mock

import torch
from timm.models.vision_transformer_sam import VisionTransformerSAM
from torch import Tensor, nn

from mvsam.build import build
from mvsam.model import MultiViewSAM
from mvsam.types import Targets, Views

SIDE = 64


def small_backbone() -> VisionTransformerSAM:
    """SAM's image encoder for 64 pixels; windows of 3 do not divide the 4 x 4 tokens, as 14 does
    not divide 64."""
    return VisionTransformerSAM(
        img_size=SIDE,
        patch_size=16,
        embed_dim=24,
        depth=4,
        num_heads=2,
        num_classes=0,
        use_rel_pos=True,
        window_size=3,
        global_attn_indexes=(1, 3),
        neck_chans=256,
        norm_layer=partial(nn.LayerNorm, eps=1e-6),  # pyright: ignore[reportArgumentType]
    )


def small_model(name: str, num_classes: int = 20, seed: int = 0, **options) -> MultiViewSAM:
    """The model of that name, small, with seeded weights."""
    torch.manual_seed(seed)
    with (
        mock.patch("mvsam.assemblies.paper.sam_vit_b", small_backbone),
        mock.patch("mvsam.assemblies.tiny.TINY_SIDE", SIDE),
    ):
        model = build(name, num_classes, **options)
    assert isinstance(model, MultiViewSAM)
    if model.semantic_encoder is not None:
        model.semantic_encoder.input_side = SIDE
    _leave_zero(model)
    return model


def _leave_zero(model: nn.Module) -> None:
    """Weights that begin at zero would hide what lies behind them; one step later they do not."""
    with torch.no_grad():
        for parameter in model.parameters():
            if parameter.dim() > 1 and parameter.eq(0).all():
                parameter.normal_(0, 0.05)


def random_views(
    batch: int = 1,
    num_views: int = 3,
    height: int = 32,
    width: int = 64,
    seed: int = 0,
    measured: bool = False,
) -> Views:
    """Noise seen by cameras a few centimetres and degrees apart."""
    generator = torch.Generator().manual_seed(seed)
    intrinsics = torch.tensor(
        [[0.9 * width, 0, width / 2], [0, 0.9 * width, height / 2], [0, 0, 1]]
    )
    poses = random_poses(batch * num_views, generator).unflatten(0, (batch, num_views))
    depth = 0.5 + 4 * torch.rand(batch, height, width, generator=generator)
    return Views(
        images=torch.rand(batch, num_views, 3, height, width, generator=generator),
        intrinsics=intrinsics.expand(batch, num_views, 3, 3).clone(),
        world_from_cam=poses,
        depth_range=torch.tensor([0.1, 5.0]).repeat(batch, 1),
        measured_depth=depth if measured else None,
    )


def random_poses(count: int, generator: torch.Generator, angle: float = 0.1) -> Tensor:
    """Rigid motions: rotations of about `angle` radians, centres within about 15 cm."""
    turn = angle * torch.randn(count, 3, generator=generator)
    x, y, z = turn.unbind(-1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    poses = torch.eye(4).repeat(count, 1, 1)
    poses[:, :3, :3] = torch.linalg.matrix_exp(skew)
    poses[:, :3, 3] = 0.1 * torch.randn(count, 3, generator=generator)
    return poses


def random_targets(
    batch: int = 1, height: int = 32, width: int = 64, seed: int = 0, num_classes: int = 20
) -> Targets:
    """Every pixel has a depth inside [0.1, 5] m and a label."""
    generator = torch.Generator().manual_seed(seed)
    return Targets(
        depth=0.5 + 4 * torch.rand(batch, height, width, generator=generator),
        labels=torch.randint(num_classes, (batch, height, width), generator=generator),
    )


def shuffle_statistics(model: nn.Module, seed: int = 0) -> None:
    """Gives batch norms running statistics unlike their initial ones, so that they matter."""
    generator = torch.Generator().manual_seed(seed)
    for module in model.modules():
        if isinstance(module, nn.BatchNorm2d | nn.BatchNorm3d):
            assert module.running_mean is not None and module.running_var is not None
            module.running_mean.normal_(0, 0.1, generator=generator)
            module.running_var.uniform_(0.5, 1.5, generator=generator)
