"""Rigid motions as 4x4 matrices; names read `target_from_source`."""

import torch
from jaxtyping import Float
from torch import Tensor


def invert(target_from_source: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
    """`source_from_target`, by transposing the rotation (exact for rigid motions only)."""
    rotation = target_from_source[..., :3, :3].mT
    translation = -(rotation @ target_from_source[..., :3, 3:])
    top = torch.cat([rotation, translation], dim=-1)
    return torch.cat([top, target_from_source[..., 3:, :]], dim=-2)


def transform(
    target_from_source: Float[Tensor, "*batch 4 4"], points: Float[Tensor, "*batch height width 3"]
) -> Float[Tensor, "*batch height width 3"]:
    """Points of the source frame, expressed in the target frame."""
    rotation = target_from_source[..., :3, :3]
    translation = target_from_source[..., None, None, :3, 3]
    return torch.einsum("...ij,...hwj->...hwi", rotation, points) + translation
