"""Eq. 2: the variance over the views of features warped to every depth hypothesis."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from mvsam.geometry.warp import source_from_reference_pixels, warp_to_reference


def variance_volume(
    features: Sequence[Float[Tensor, "batch channel height width"]],
    intrinsics: Float[Tensor, "batch view 3 3"],
    world_from_cam: Float[Tensor, "batch view 4 4"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch channel plane height width"]:
    """Variance over all views, the reference (view 0) included; biased, 1/M, as Eq. 2 writes it.

    Samples outside a source view enter as zeros. One warped view is held at a time: the volume is
    mean(V^2) - mean(V)^2, accumulated in float32 because the difference cancels in bfloat16.
    `intrinsics` are those of the feature maps.
    """
    hypotheses = hypotheses.float()
    total = features[0].float()[:, :, None]
    total_of_squares = total.square()
    for view, source in enumerate(features[1:], start=1):
        linear, offset = source_from_reference_pixels(intrinsics, world_from_cam, view)
        warped = warp_to_reference(source.float(), linear, offset, hypotheses)
        total = total + warped
        total_of_squares = torch.addcmul(total_of_squares, warped, warped)
    num_views = len(features)
    return total_of_squares / num_views - (total / num_views).square()
