"""The plane sweep as one operation on a GPU: Eq. 1 and Eq. 2 in Triton, forward and backward.

Same function and same gradients as `textbook_variance_volume`; no warped volume is ever stored.

Channels are innermost, in the features and in the volume. A gather anywhere in a source view then
reads one run of memory (64 bytes for 32 channels in bfloat16), a position is worked out once for
the run, and the 3D convolutions that follow want this layout too. Features are read in the type
they come in, which under autocast is bfloat16 and half the traffic; sums are float32.

A program sweeps eight planes over a run of pixels, one plane after the other: the reference's
features stay in registers, and neighbouring planes find their samples in the cache of the plane
before, since they lie about a pixel apart. 128 threads hold four values each; on Hopper and later
the float32 gradient then leaves in 16-byte atomic additions, straight from the thread that has it.
"""

from typing import no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from mvsam.geometry.warp import MINIMUM_Z

TILE_VALUES = 512
"""Pixels times channels of one program: four for each of its 128 threads."""
TILE_PLANES = 8
_MINIMUM_Z = tl.constexpr(MINIMUM_Z)


def sweep_variance(
    features: Float[Tensor, "batch view channel height width"],
    projections: Float[Tensor, "batch view 12"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch channel plane height width"]:
    """Variance volume in channels-last layout, in the features' type; gradient to the features.

    The gradient's sums are atomic, so their order and last digits differ from run to run.
    """
    channels_last = features.permute(0, 1, 3, 4, 2)
    volume = _variance(channels_last, projections.float(), hypotheses.float())
    return volume.permute(0, 4, 1, 2, 3)


# Registered with torch, so that torch.compile sees two opaque operations and their shapes.
@torch.library.custom_op("mvsam::sweep_variance", mutates_args=())
def _variance(features: Tensor, projections: Tensor, hypotheses: Tensor) -> Tensor:
    """(batch, view, height, width, channel) to (batch, plane, height, width, channel)."""
    volume = _empty_volume(features, projections, hypotheses)
    _launch(_variance_kernel, features, projections, hypotheses, volume)
    return volume


@_variance.register_fake
def _empty_volume(features: Tensor, projections: Tensor, hypotheses: Tensor) -> Tensor:
    batch, _, height, width, channels = features.shape
    return features.new_empty(batch, hypotheses.shape[1], height, width, channels)


@torch.library.custom_op("mvsam::sweep_variance_backward", mutates_args=())
def _gradient(
    features: Tensor, projections: Tensor, hypotheses: Tensor, incoming: Tensor
) -> Tensor:
    """Of the features, from that of the volume."""
    gradient = torch.zeros(features.shape, dtype=torch.float32, device=features.device)
    _launch(_gradient_kernel, features, projections, hypotheses, incoming.contiguous(), gradient)
    return gradient.to(features.dtype)


@_gradient.register_fake
def _empty_gradient(
    features: Tensor, projections: Tensor, hypotheses: Tensor, incoming: Tensor
) -> Tensor:
    return features.new_empty(features.shape)


def _keep_inputs(ctx, inputs, output) -> None:
    ctx.save_for_backward(*inputs)


def _backward(ctx, incoming):
    return _gradient(*ctx.saved_tensors, incoming), None, None


_variance.register_autograd(_backward, setup_context=_keep_inputs)


def _launch(kernel, features: Tensor, projections: Tensor, hypotheses: Tensor, *volumes: Tensor):
    batch, views, height, width, channels = features.shape
    planes = hypotheses.shape[1]
    tile_channels = triton.next_power_of_2(channels)
    tile_pixels = max(1, TILE_VALUES // tile_channels)
    tiles = triton.cdiv(height * width, tile_pixels), triton.cdiv(planes, TILE_PLANES), batch
    with torch.cuda.device_of(features):
        kernel[tiles](
            features.contiguous(),
            projections.contiguous(),
            hypotheses,
            *volumes,
            *hypotheses.stride(),
            *(views, planes, height, width),
            channels,
            tile_pixels,
            tile_channels,
            TILE_PLANES,
        )


# The kernels are no_type_check because the tests' type checker would put its wrapper into them.


@triton.jit
@no_type_check
def _variance_kernel(
    features,  # item, view, pixel, channel
    projections,  # item, view, 12: A row by row, then b; the reference's are not read
    hypotheses,  # item, plane, row, column with the strides below
    volume,  # item, plane, pixel, channel
    item_stride,
    plane_stride,
    row_stride,
    column_stride,
    views,
    planes,
    height,
    width,
    channels: tl.constexpr,
    tile_pixels: tl.constexpr,
    tile_channels: tl.constexpr,
    tile_planes: tl.constexpr,
):
    item = tl.program_id(2).to(tl.int64)
    image_size = height * width * channels
    features += item * views * image_size
    projections += item * views * 12
    volume += item * planes * image_size
    row, column, channel, offset, in_image = _tile(
        height, width, channels, tile_pixels, tile_channels
    )
    hypotheses += item * item_stride + row * row_stride + column * column_stride
    mask = in_image[:, None] & (channel < channels)[None, :]

    reference = tl.load(features + offset, mask=mask, other=0.0).to(tl.float32)
    first = tl.program_id(1) * tile_planes
    for plane in range(first, tl.minimum(first + tile_planes, planes)):
        depth = tl.load(hypotheses + plane * plane_stride, mask=in_image, other=0.0)
        total = reference
        squares = reference * reference
        for view in range(1, views):
            x, y, in_view = _project(projections + view * 12, row, column, depth, height, width)
            image = features + tl.cast(view, tl.int64) * image_size
            value = _sample(image, x, y, in_view, channel, height, width, channels)
            total += value
            squares += value * value
        mean = total / views
        variance = (squares / views - mean * mean).to(volume.dtype.element_ty)
        tl.store(volume + tl.cast(plane, tl.int64) * image_size + offset, variance, mask=mask)


@triton.jit
@no_type_check
def _gradient_kernel(
    features,
    projections,
    hypotheses,
    incoming,  # item, plane, pixel, channel: gradient of the volume
    gradient,  # item, view, pixel, channel: float32, zero at the start
    item_stride,
    plane_stride,
    row_stride,
    column_stride,
    views,
    planes,
    height,
    width,
    channels: tl.constexpr,
    tile_pixels: tl.constexpr,
    tile_channels: tl.constexpr,
    tile_planes: tl.constexpr,
):
    """d variance / d V_i = 2 / M (V_i - mean); each source is sampled anew, for either term."""
    item = tl.program_id(2).to(tl.int64)
    image_size = height * width * channels
    features += item * views * image_size
    projections += item * views * 12
    incoming += item * planes * image_size
    gradient += item * views * image_size
    row, column, channel, offset, in_image = _tile(
        height, width, channels, tile_pixels, tile_channels
    )
    hypotheses += item * item_stride + row * row_stride + column * column_stride
    mask = in_image[:, None] & (channel < channels)[None, :]

    reference = tl.load(features + offset, mask=mask, other=0.0).to(tl.float32)
    reference_gradient = tl.zeros([tile_pixels, tile_channels], tl.float32)
    first = tl.program_id(1) * tile_planes
    for plane in range(first, tl.minimum(first + tile_planes, planes)):
        depth = tl.load(hypotheses + plane * plane_stride, mask=in_image, other=0.0)
        total = reference
        for view in range(1, views):
            x, y, in_view = _project(projections + view * 12, row, column, depth, height, width)
            image = features + tl.cast(view, tl.int64) * image_size
            total += _sample(image, x, y, in_view, channel, height, width, channels)
        mean = total / views
        volume = incoming + tl.cast(plane, tl.int64) * image_size
        scaled = tl.load(volume + offset, mask=mask, other=0.0).to(tl.float32) * (2.0 / views)
        reference_gradient += scaled * (reference - mean)
        for view in range(1, views):
            x, y, in_view = _project(projections + view * 12, row, column, depth, height, width)
            image = features + tl.cast(view, tl.int64) * image_size
            target = gradient + tl.cast(view, tl.int64) * image_size
            value = _sample(image, x, y, in_view, channel, height, width, channels)
            flow = scaled * (value - mean)
            for corner in tl.static_range(4):
                at, weight, inside = _corner(
                    x, y, in_view, channel, height, width, channels, corner
                )
                tl.atomic_add(target + at, weight * flow, mask=inside, sem="relaxed")
    # Once a program: other programs hold other planes of the same pixels.
    tl.atomic_add(gradient + offset, reference_gradient, mask=mask, sem="relaxed")


@triton.jit
@no_type_check
def _tile(
    height,
    width,
    channels: tl.constexpr,
    tile_pixels: tl.constexpr,
    tile_channels: tl.constexpr,
):
    """This program's pixels and channels, where they lie in an image, and which pixels exist."""
    pixel = tl.program_id(0) * tile_pixels + tl.arange(0, tile_pixels)
    channel = tl.arange(0, tile_channels)
    offset = pixel[:, None] * channels + channel[None, :]
    return pixel // width, pixel % width, channel, offset, pixel < height * width


@triton.jit
@no_type_check
def _project(projection, row, column, depth, height, width):
    """Eq. 1: (x, y) from the centre of the source's first pixel, and whether a corner is inside."""
    m = projection
    u = column + 0.5
    v = row + 0.5
    z = (tl.load(m + 6) * u + tl.load(m + 7) * v + tl.load(m + 8)) * depth + tl.load(m + 11)
    in_front = z > _MINIMUM_Z
    scale = 1.0 / tl.where(in_front, z, 1.0)
    x = (tl.load(m + 0) * u + tl.load(m + 1) * v + tl.load(m + 2)) * depth + tl.load(m + 9)
    y = (tl.load(m + 3) * u + tl.load(m + 4) * v + tl.load(m + 5)) * depth + tl.load(m + 10)
    x = x * scale - 0.5
    y = y * scale - 0.5
    in_view = in_front & (x > -1) & (y > -1) & (x < width) & (y < height)
    return tl.where(in_view, x, 0.0), tl.where(in_view, y, 0.0), in_view


@triton.jit
@no_type_check
def _sample(image, x, y, in_view, channel, height, width, channels: tl.constexpr):
    """Bilinear, float32; zero outside."""
    value = tl.zeros([x.shape[0], channel.shape[0]], tl.float32)
    for corner in tl.static_range(4):
        at, weight, inside = _corner(x, y, in_view, channel, height, width, channels, corner)
        value += weight * tl.load(image + at, mask=inside, other=0.0).to(tl.float32)
    return value


@triton.jit
@no_type_check
def _corner(
    x,
    y,
    in_view,
    channel,
    height,
    width,
    channels: tl.constexpr,
    corner: tl.constexpr,
):
    """One of the four neighbours: where its channels lie, its weight, whether it is inside."""
    column = tl.floor(x).to(tl.int32) + corner % 2
    row = tl.floor(y).to(tl.int32) + corner // 2
    inside = in_view & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    weight = (1 - tl.abs(x - column)) * (1 - tl.abs(y - row))
    at = (row * width + column)[:, None] * channels + channel[None, :]
    return at, weight[:, None], inside[:, None] & (channel < channels)[None, :]
