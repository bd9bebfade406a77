"""Pinhole cameras in the corner convention: the image covers [0, W] x [0, H]."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

HALF_PIXEL = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
"""From a calibration that counts pixel centres at integers to the corner convention."""


def pixel_centres(
    height: int, width: int, *, device=None, dtype=torch.float32
) -> Float[Tensor, "height width 3"]:
    """Homogeneous centres (column + 0.5, row + 0.5, 1) of every pixel."""
    rows = torch.arange(height, device=device, dtype=dtype) + 0.5
    columns = torch.arange(width, device=device, dtype=dtype) + 0.5
    v, u = torch.meshgrid(rows, columns, indexing="ij")
    return torch.stack([u, v, torch.ones_like(u)], dim=-1)


def scale_intrinsics(
    intrinsics: Float[Tensor, "*batch 3 3"], scale_x: float, scale_y: float
) -> Float[Tensor, "*batch 3 3"]:
    """Intrinsics of the image resized by these factors; with corners at 0 no half pixel enters."""
    factors = intrinsics.new_tensor([scale_x, scale_y, 1.0])
    return intrinsics * factors[:, None]


def invert_intrinsics(intrinsics: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Their inverse, by cross products of the columns.

    Not `torch.linalg.inv`: ONNX has no such operation, and on a GPU it waits for the result.
    """
    x, y, z = intrinsics.unbind(dim=-1)
    rows = [torch.linalg.cross(y, z), torch.linalg.cross(z, x), torch.linalg.cross(x, y)]
    determinant = (x * rows[0]).sum(dim=-1)
    return torch.stack(rows, dim=-2) / determinant[..., None, None]
