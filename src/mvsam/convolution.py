"""Convolutions of prediction: batch norm inside the weights, the ReLU inside the convolution.

On CPUs in float32 oneDNN is called directly. PyTorch's own choice for one 3D volume of moderate
depth is its old code, which writes out 27 copies of the volume first (docs/log.md). What training
calls is in `convolution_gradient.py`.
"""

import copy
from itertools import pairwise
from typing import TypeVar

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from mvsam import convolution_gradient
from mvsam.convolution_gradient import Convolution, suits_onednn

AnyModule = TypeVar("AnyModule", bound=nn.Module)
BatchNorm = nn.BatchNorm2d | nn.BatchNorm3d


def fold_batch_norm(model: AnyModule) -> AnyModule:
    """A copy of the model for prediction: each batch norm multiplied into the convolution before.

    Only convolutions, batch norms and ReLUs that follow each other in an `nn.Sequential` are
    folded. All other weights are shared with `model`, which stays as it was and is the one to train
    and to save; weights that change later do not reach the copy. Outputs are equal to float32
    rounding, in evaluation mode.
    """
    shared = {id(tensor): tensor for tensor in (*model.parameters(), *model.buffers())}
    folded = copy.deepcopy(model, shared)
    for module in list(folded.modules()):
        if isinstance(module, nn.Sequential):
            _fold_children(module)
    return folded.eval()


def _fold_children(sequence: nn.Sequential) -> None:
    layers = list(sequence)
    for index, (layer, norm) in enumerate(pairwise(layers)):
        if not isinstance(layer, Convolution) or not isinstance(norm, BatchNorm):
            continue
        is_plain = layer.padding_mode == "zeros" and not isinstance(layer.padding, str)
        if is_plain and norm.track_running_stats:
            has_relu = index + 2 < len(layers) and isinstance(layers[index + 2], nn.ReLU)
            sequence[index] = FoldedConvolution(layer, norm, has_relu)
            sequence[index + 1] = nn.Identity()
            if has_relu:
                sequence[index + 2] = nn.Identity()


class FoldedConvolution(nn.Module):
    """A convolution with the batch norm, and where there was one the ReLU, that followed it."""

    def __init__(self, convolution: Convolution, norm: BatchNorm, has_relu: bool):
        super().__init__()
        with torch.no_grad():
            self.convolution = fuse_conv_bn_eval(
                convolution.eval(), norm.eval(), transpose=convolution.transposed
            ).requires_grad_(False)
        self.has_relu = has_relu

    def forward(
        self, x: Float[Tensor, "batch _channel *_size"]
    ) -> Float[Tensor, "batch _channels *_sizes"]:
        if fits_onednn(x):
            return convolve_by_onednn(self.convolution, x, self.has_relu)
        x = self.convolution(x)
        return x.relu_() if self.has_relu else x


class Conv2d(nn.Conv2d):
    """`nn.Conv2d` by oneDNN; PyTorch's code for 1x1 kernels copies its input."""

    def forward(
        self, x: Float[Tensor, "batch _channel _height _width"]
    ) -> Float[Tensor, "batch _channels _rows _columns"]:
        if convolution_gradient.fits_kernel(self, x):
            return convolution_gradient.convolve(self, x)
        return convolve_by_onednn(self, x) if fits_onednn(x) else super().forward(x)


def conv_bn_relu(
    in_channels: int, out_channels: int, kernel_size: int = 3, stride: int = 1
) -> nn.Sequential:
    """Convolution without bias, batch norm, ReLU; `stride` divides the size."""
    padding = kernel_size // 2
    return nn.Sequential(
        Conv2d(in_channels, out_channels, kernel_size, stride, padding, bias=False),
        nn.BatchNorm2d(out_channels),
        nn.ReLU(inplace=True),
    )


def add(x: Tensor, other: Tensor) -> Tensor:
    """x + other; into x, which must be the caller's own, where no gradient needs it."""
    return x + other if torch.is_grad_enabled() else x.add_(other)


def fits_onednn(x: Tensor) -> bool:
    """Whether `convolve_by_onednn` can take this input, here and now."""
    return not torch.is_grad_enabled() and suits_onednn(x)


def convolve_by_onednn(layer: Convolution, x: Tensor, has_relu: bool = False) -> Tensor:
    """What `layer` gives, by oneDNN whatever PyTorch would choose; without a gradient."""
    after, shape = "relu" if has_relu else "none", (layer.stride, layer.dilation, layer.groups)
    arguments = (x, layer.weight, layer.bias, layer.padding)
    if layer.transposed:
        return torch.ops.mkldnn._convolution_transpose_pointwise(
            *arguments, layer.output_padding, *shape, after, [], ""
        )
    return torch.ops.mkldnn._convolution_pointwise(*arguments, *shape, after, [], "")
