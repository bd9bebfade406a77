"""Eq. 2: the variance over the views of features warped to every depth hypothesis."""

import torch
from jaxtyping import Float
from torch import Tensor

from mvsam.geometry.warp import source_from_reference_pixels, warp_to_reference
from mvsam.mvs.sweep import fits_kernel, sweep_variance


def variance_volume(
    features: Float[Tensor, "batch view channel height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    world_from_cam: Float[Tensor, "batch view 4 4"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch channel plane height width"]:
    """Variance over all views, the reference (view 0) included; biased, 1/M, as Eq. 2 writes it.

    `intrinsics` are those of the feature maps; hypotheses in metres. Samples outside a source view
    or behind its camera enter as zeros. The result is in the features' type; gradients go to the
    features alone. On a CPU the compiled sweep does it; `textbook_variance_volume` says what.
    """
    if not fits_kernel(features, hypotheses):
        return textbook_variance_volume(features, intrinsics, world_from_cam, hypotheses)
    identity = features.new_zeros((len(features), 12), dtype=torch.float64)  # not read
    projections = [identity]
    for view in range(1, features.shape[1]):
        linear, offset = source_from_reference_pixels(intrinsics, world_from_cam, view)
        projections.append(torch.cat([linear.flatten(1), offset], dim=1))
    return sweep_variance(features, torch.stack(projections, dim=1), hypotheses)


def textbook_variance_volume(
    features: Float[Tensor, "batch view channel height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    world_from_cam: Float[Tensor, "batch view 4 4"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch channel plane height width"]:
    """The specification of `variance_volume`, in plain PyTorch on any device.

    mean(V^2) - mean(V)^2 with one warped view held at a time, accumulated at least in float32
    because the difference cancels in bfloat16.
    """
    dtype = torch.promote_types(features.dtype, torch.float32)
    wide = features.to(dtype)
    total = wide[:, 0, :, None].expand(-1, -1, hypotheses.shape[1], -1, -1)
    total_of_squares = total.square()
    for view in range(1, features.shape[1]):
        linear, offset = source_from_reference_pixels(intrinsics, world_from_cam, view)
        warped = warp_to_reference(wide[:, view], linear, offset, hypotheses.to(dtype))
        total = total + warped
        total_of_squares = torch.addcmul(total_of_squares, warped, warped)
    num_views = features.shape[1]
    variance = total_of_squares / num_views - (total / num_views).square()
    return variance.to(features.dtype)
