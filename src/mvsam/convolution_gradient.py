"""Convolutions of training on a CPU: oneDNN called directly, and our own gradient of the weights.

oneDNN has no kernel for that gradient on AVX2; `convolution.cpp` has (docs/log.md). Float32 alone;
without a compiler, and for all other layers, PyTorch's own code runs.
"""

import ctypes
from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from mvsam.kernels import load_kernel, num_shares, share_rows

SOURCE = Path(__file__).with_name("convolution.cpp")
Convolution = nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d | nn.ConvTranspose3d


def suits_onednn(x: Tensor) -> bool:
    """Whether oneDNN may be called with this input, here and now, past PyTorch's own choice."""
    return (
        x.device.type == "cpu"
        and x.dtype == torch.float32
        and not torch.is_autocast_enabled("cpu")
        and torch.backends.mkldnn.is_available()
        and torch.backends.mkldnn.enabled
        and not torch.compiler.is_compiling()
    )


def fits_kernel(layer: Convolution, x: Tensor) -> bool:
    """Whether `convolve` can take this layer and this input, here and now."""
    fine, coarse, stride = layer.in_channels, layer.out_channels, layer.stride[0]
    divides = x.shape[-1] % stride == 0
    if layer.transposed:
        fine, coarse, divides = coarse, fine, layer.output_padding[-1] == stride - 1
    return (
        torch.is_grad_enabled()
        and suits_onednn(x)
        and set(layer.kernel_size) == {3}
        and set(layer.stride) in ({1}, {2})
        and set(layer.padding) == set(layer.dilation) == {layer.groups} == {1}
        and layer.padding_mode == "zeros"
        and layer.bias is None
        and fine % 4 == coarse % 8 == 0
        and divides
        and load_kernel(SOURCE) is not None
    )


def convolve(
    layer: Convolution, x: Float[Tensor, "batch _channel *_size"]
) -> Float[Tensor, "batch _channels *_sizes"]:
    """What `layer` gives, with its gradients."""
    stride = layer.stride[0]
    if not layer.transposed:
        return _Down.apply(x, layer.weight, stride)
    pairs = zip(x.shape[2:], layer.output_padding, strict=True)
    size = [stride * (count - 1) + 1 + padding for count, padding in pairs]
    return _Up.apply(x, layer.weight, size, stride)


class _Down(torch.autograd.Function):
    """A convolution."""

    @staticmethod
    def forward(ctx, fine, weight, stride):
        ctx.save_for_backward(fine, weight)
        ctx.stride = stride
        return _down(fine, weight, stride)

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):  # pyright: ignore[reportIncompatibleMethodOverride]
        fine, weight = ctx.saved_tensors
        of_fine, of_weight = ctx.needs_input_grad[:2]
        return (
            _up(gradient, weight, fine.shape[2:], ctx.stride) if of_fine else None,
            weight_gradient(fine, gradient, ctx.stride) if of_weight else None,
            None,
        )


class _Up(torch.autograd.Function):
    """A transposed convolution: the same with the roles exchanged."""

    @staticmethod
    def forward(ctx, coarse, weight, size, stride):
        ctx.save_for_backward(coarse, weight)
        ctx.stride = stride
        return _up(coarse, weight, size, stride)

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):  # pyright: ignore[reportIncompatibleMethodOverride]
        coarse, weight = ctx.saved_tensors
        of_coarse, of_weight = ctx.needs_input_grad[:2]
        return (
            _down(gradient, weight, ctx.stride) if of_coarse else None,
            weight_gradient(gradient, coarse, ctx.stride) if of_weight else None,
            None,
            None,
        )


def _down(fine: Tensor, weight: Tensor, stride: int) -> Tensor:
    axes = fine.dim() - 2
    shape = ([1] * axes, [stride] * axes, [1] * axes, 1)
    return torch.ops.mkldnn._convolution_pointwise(fine, weight, None, *shape, "none", [], "")


def _up(coarse: Tensor, weight: Tensor, size: Sequence[int], stride: int) -> Tensor:
    axes = coarse.dim() - 2
    beyond = [n - stride * (m - 1) - 1 for n, m in zip(size, coarse.shape[2:], strict=True)]
    shape = ([1] * axes, beyond, [stride] * axes, [1] * axes, 1)
    return torch.ops.mkldnn._convolution_transpose_pointwise(
        coarse, weight, None, *shape, "none", [], ""
    )


def weight_gradient(
    fine: Float[Tensor, "batch channel *_fine_size"],
    coarse: Float[Tensor, "batch channels *_coarse_size"],
    stride: int,
) -> Float[Tensor, "channels channel *_taps"]:
    """Of a convolution from `fine` to `coarse`: its input and the gradient of its output.

    Pictures or volumes, three taps an axis.
    """
    kernel, depth = load_kernel(SOURCE), 1 if fine.dim() == 4 else 3
    assert kernel is not None
    layout = torch.channels_last if depth == 1 else torch.channels_last_3d
    volumes = [x.contiguous(memory_format=layout) for x in (fine, coarse)]
    sizes = [n for x in volumes for n in (1, *x.shape[2:], x.shape[1])[-4:]]
    rows = coarse[:, 0, ..., 0].numel()
    sums = coarse.new_zeros(num_shares(rows), coarse.shape[1] // 8, depth, 3, fine.shape[1], 3, 8)

    def work(begin: int, end: int, thread: int) -> None:
        kernel.weight_gradient(
            *(ctypes.c_void_p(x.data_ptr()) for x in volumes),
            (ctypes.c_int64 * 8)(*sizes),
            *(depth, stride, ctypes.c_int64(begin), ctypes.c_int64(end)),
            ctypes.c_void_p(sums[thread].data_ptr()),
        )

    share_rows(work, rows)
    gradient = sums.sum(0).permute(0, 5, 3, 1, 2, 4).flatten(0, 1)
    return gradient.squeeze(2) if depth == 1 else gradient
