"""Eq. 1: where a reference pixel at a hypothesised depth lands in a source view."""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from mvsam.geometry.camera import invert_intrinsics, pixel_centres
from mvsam.geometry.pose import invert

MINIMUM_Z = 1e-6
"""Metres; what projects nearer than this, or behind the camera, counts as out of view."""


def source_from_reference_pixels(
    intrinsics: Float[Tensor, "batch view 3 3"],
    world_from_cam: Float[Tensor, "batch view 4 4"],
    source: int,
    reference: int = 0,
) -> tuple[Float[Tensor, "batch 3 3"], Float[Tensor, "batch 3"]]:
    """(A, b) with source pixel ~ A (depth * p) + b for a homogeneous reference pixel p.

    Eq. 1 multiplied out: A = K_i R_i^T R_0 K_0^-1 and b = K_i R_i^T (t_0 - t_i). Worked out in
    float64, because the product of two inverses loses half of float32's digits.
    """
    intrinsics, world_from_cam = intrinsics.double(), world_from_cam.double()
    source_from_reference = invert(world_from_cam[:, source]) @ world_from_cam[:, reference]
    rotation, translation = source_from_reference[:, :3, :3], source_from_reference[:, :3, 3]
    linear = intrinsics[:, source] @ rotation @ invert_intrinsics(intrinsics[:, reference])
    offset = (intrinsics[:, source] @ translation[:, :, None])[:, :, 0]
    return linear, offset


def project_hypotheses(
    linear: Float[Tensor, "batch 3 3"],
    offset: Float[Tensor, "batch 3"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> tuple[Float[Tensor, "batch plane height width 2"], Bool[Tensor, "batch plane height width"]]:
    """Source coordinates (u', v') in pixels and whether the point lies before the source camera."""
    height, width = hypotheses.shape[-2:]
    dtype = hypotheses.dtype
    pixels = pixel_centres(height, width, device=hypotheses.device, dtype=torch.float64)
    rays = torch.einsum("bij,hwj->bihw", linear, pixels).to(dtype)
    offset = offset.to(dtype)

    def row(index: int) -> Tensor:
        return torch.addcmul(offset[:, index, None, None, None], rays[:, index, None], hypotheses)

    z = row(2)
    in_front = z > MINIMUM_Z
    inverse_z = torch.where(in_front, z, torch.ones_like(z)).reciprocal_()
    coordinates = torch.stack([row(0) * inverse_z, row(1) * inverse_z], dim=-1)
    return coordinates, in_front


def sample_bilinear(
    image: Float[Tensor, "batch channel height width"],
    coordinates: Float[Tensor, "batch plane rows columns 2"],
    in_front: Bool[Tensor, "batch plane rows columns"],
) -> Float[Tensor, "batch channel plane rows columns"]:
    """The image read at pixel coordinates; zero outside it and behind the camera."""
    height, width = image.shape[-2:]
    scale = coordinates.new_tensor([2.0 / width, 2.0 / height])
    grid = coordinates * scale - 1.0
    grid = torch.where(in_front[..., None], grid, grid.new_full((), -99.0))
    planes, rows = grid.shape[1:3]
    flat = grid.flatten(1, 2)
    sampled = F.grid_sample(image, flat, mode="bilinear", padding_mode="zeros", align_corners=False)
    return sampled.unflatten(2, (planes, rows))


def warp_to_reference(
    features: Float[Tensor, "batch channel height width"],
    linear: Float[Tensor, "batch 3 3"],
    offset: Float[Tensor, "batch 3"],
    hypotheses: Float[Tensor, "batch plane rows columns"],
) -> Float[Tensor, "batch channel plane rows columns"]:
    """A source view's features seen from every hypothesis of the reference (the paper's V_i)."""
    with torch.no_grad():  # as CasMVSNet: no gradient through the sampling positions
        coordinates, in_front = project_hypotheses(linear, offset, hypotheses)
    return sample_bilinear(features, coordinates, in_front)
