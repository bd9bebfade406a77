"""The plane sweep as one operation on the CPU: `sweep.cpp`, compiled on first use.

Without a compiler `cost_volume` takes its plain PyTorch form.
"""

import ctypes
from functools import partial
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from mvsam.kernels import load_kernel, num_shares, share_rows

KERNEL_CHANNELS = (8, 16, 32)
MAXIMUM_VIEWS = 16
SOURCE = Path(__file__).with_name("sweep.cpp")


def fits_kernel(features: Tensor, hypotheses: Tensor) -> bool:
    """Whether the kernel can take this problem; `cost_volume` asks before it calls."""
    return (
        features.device.type == "cpu"
        and features.dtype in (torch.float32, torch.bfloat16)
        and hypotheses.dtype == torch.float32
        and features.shape[2] in KERNEL_CHANNELS
        and features.shape[1] <= MAXIMUM_VIEWS
        and load_kernel(SOURCE) is not None
    )


def sweep_variance(
    features: Float[Tensor, "batch view channel height width"],
    projections: Float[Tensor, "batch view 12"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch channel plane height width"]:
    """Variance volume in channels-last layout, in the features' type; gradient to the features."""
    return _Sweep.apply(features, projections, hypotheses)


class _Sweep(torch.autograd.Function):
    @staticmethod
    def forward(ctx, features, projections, hypotheses):
        channels_last = features.detach().permute(0, 1, 3, 4, 2).float().contiguous()
        projections = projections.float().contiguous()
        batch, _, height, width, channels = channels_last.shape
        shape = (batch, hypotheses.shape[1], height, width, channels)
        volume = torch.empty(shape, dtype=features.dtype)
        for item in range(batch):
            call = _Call(channels_last[item], projections[item], hypotheses[item], volume[item])
            share_rows(call.forward, call.height)
        ctx.save_for_backward(channels_last, projections, hypotheses)
        ctx.dtype = features.dtype
        return volume.permute(0, 4, 1, 2, 3)

    @staticmethod
    @once_differentiable
    def backward(ctx, volume_gradient):  # pyright: ignore[reportIncompatibleMethodOverride]
        channels_last, projections, hypotheses = ctx.saved_tensors
        incoming = volume_gradient.permute(0, 2, 3, 4, 1).contiguous()
        gradient = torch.empty_like(channels_last)
        for item in range(len(channels_last)):
            call = _Call(channels_last[item], projections[item], hypotheses[item], incoming[item])
            # Rows of the reference scatter anywhere into a source: a copy for each thread.
            num_copies = num_shares(call.height)
            copies = channels_last.new_zeros((num_copies, *channels_last[item].shape))
            share_rows(partial(call.backward, copies), call.height)
            gradient[item] = copies.sum(0) if len(copies) > 1 else copies[0]
        return gradient.permute(0, 1, 4, 2, 3).to(ctx.dtype), None, None


class _Call:
    """One batch item's arguments in the kernel's terms."""

    def __init__(self, features: Tensor, projection: Tensor, hypotheses: Tensor, volume: Tensor):
        self.kernel = load_kernel(SOURCE)
        self.height = features.shape[1]
        self.volume = volume
        views, height, width, channels = features.shape
        strides = (ctypes.c_int64 * 3)(*hypotheses.stride())
        shape = (ctypes.c_int64 * 5)(views, hypotheses.shape[0], height, width, channels)
        pointers = [ctypes.c_void_p(x.data_ptr()) for x in (features, projection, hypotheses)]
        self.arguments = (*pointers, strides, shape)

    def forward(self, begin: int, end: int, _thread: int) -> None:
        assert self.kernel is not None
        is_bfloat16 = int(self.volume.dtype == torch.bfloat16)
        target = ctypes.c_void_p(self.volume.data_ptr())
        assert self.kernel.sweep_forward(*self.arguments, begin, end, is_bfloat16, target) == 0

    def backward(self, copies: Tensor, begin: int, end: int, thread: int) -> None:
        assert self.kernel is not None
        is_bfloat16 = int(self.volume.dtype == torch.bfloat16)
        incoming = ctypes.c_void_p(self.volume.data_ptr())
        target = ctypes.c_void_p(copies[thread].data_ptr())
        status = self.kernel.sweep_backward(
            *self.arguments, begin, end, is_bfloat16, incoming, target
        )
        assert status == 0
