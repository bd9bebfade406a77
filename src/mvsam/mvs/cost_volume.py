"""Eq. 2: the variance over the views of features warped to every depth hypothesis."""

from collections.abc import Callable
from importlib.util import find_spec

import torch
from jaxtyping import Float
from torch import Tensor

from mvsam.geometry.warp import source_from_reference_pixels, warp_to_reference
from mvsam.kernels import is_switched_off
from mvsam.mvs import sweep_export
from mvsam.mvs.sweep import fits_kernel, sweep_variance

HAS_TRITON = find_spec("triton") is not None
"""It comes with PyTorch on Linux."""


def variance_volume(
    features: Float[Tensor, "batch view channel height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    world_from_cam: Float[Tensor, "batch view 4 4"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch channel plane height width"]:
    """Variance over all views, the reference (view 0) included; biased, 1/M, as Eq. 2 writes it.

    `intrinsics` are those of the feature maps; hypotheses in metres. Samples outside a source view
    or behind its camera enter as zeros. The result is in the features' type; gradients go to the
    features alone. One operation does it where there is a compiler for C++ (CPU) or Triton (GPU);
    `textbook_variance_volume` says what.
    """
    sweep = _fused_sweep(features, hypotheses)
    if sweep is None:
        return textbook_variance_volume(features, intrinsics, world_from_cam, hypotheses)
    return sweep(features, sweep_projections(intrinsics, world_from_cam), hypotheses)


def _fused_sweep(features: Tensor, hypotheses: Tensor) -> Callable[..., Tensor] | None:
    if torch.compiler.is_exporting():
        return sweep_export.sweep_variance
    if fits_kernel(features, hypotheses):
        return sweep_variance
    if (
        features.device.type == "cuda"
        and HAS_TRITON
        and features.dtype in (torch.float32, torch.bfloat16, torch.float16)
        and not torch.are_deterministic_algorithms_enabled()  # its gradient sums are atomic
        and not is_switched_off()
    ):
        from mvsam.mvs import sweep_triton

        return sweep_triton.sweep_variance
    return None


def sweep_projections(
    intrinsics: Float[Tensor, "batch view 3 3"], world_from_cam: Float[Tensor, "batch view 4 4"]
) -> Float[Tensor, "batch view 12"]:
    """A row by row, then b, of every view (`source_from_reference_pixels`); all in one go."""

    def beside_reference(cameras: Tensor) -> Tensor:
        pairs = torch.stack([cameras[:, :1].expand_as(cameras), cameras], dim=2)
        return pairs.flatten(0, 1)

    linear, offset = source_from_reference_pixels(
        beside_reference(intrinsics), beside_reference(world_from_cam), source=1
    )
    return torch.cat([linear.flatten(1), offset], dim=1).unflatten(0, intrinsics.shape[:2])


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
