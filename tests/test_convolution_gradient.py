"""Convolutions of training against PyTorch's own, outputs and gradients."""

import pytest
import torch
from torch import nn
from torch.nn.grad import conv3d_weight

from mvsam import convolution_gradient
from mvsam.convolution import Conv2d
from mvsam.convolution_gradient import convolve, fits_kernel, weight_gradient
from mvsam.kernels import load_kernel
from mvsam.mvs.regularizer import Conv3d, CostRegularizer
from mvsam.weights import layout_channels_last

needs_kernel = pytest.mark.skipif(
    load_kernel(convolution_gradient.SOURCE) is None,
    reason="no C++ compiler here, so there is no kernel to compare",
)

UP = {"stride": 2, "padding": 1, "output_padding": 1, "bias": False}
LAYERS = {
    "same": nn.Conv3d(8, 16, 3, padding=1, bias=False),
    "down": nn.Conv3d(4, 8, 3, 2, padding=1, bias=False),
    "up": nn.ConvTranspose3d(8, 4, 3, **UP),
    "pictures": nn.Conv2d(12, 8, 3, padding=1, bias=False),
    "pictures down": nn.Conv2d(4, 24, 3, 2, padding=1, bias=False),
    "pictures up": nn.ConvTranspose2d(16, 4, 3, **UP),
}


@pytest.fixture(params=[1, 2])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def outputs_and_gradients(convolution, layer, x):
    x = x.clone().requires_grad_()
    result = convolution(x)
    incoming = torch.sin(torch.arange(result.numel())).view_as(result)
    return result.detach(), *torch.autograd.grad(result, (x, layer.weight), incoming)


def compare(layer, x):
    assert fits_kernel(layer, x)
    fast = outputs_and_gradients(lambda x: convolve(layer, x), layer, x)
    slow = outputs_and_gradients(layer, layer, x)
    for ours, theirs in zip(fast, slow, strict=True):
        # Sums of up to some thousand products, in another order.
        torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=1e-4)


@needs_kernel
@pytest.mark.parametrize("planes", [1, 5])
@pytest.mark.parametrize("batch", [1, 3])
@pytest.mark.parametrize("layer", LAYERS.values(), ids=LAYERS)
def test_gradients_are_those_of_pytorch(layer, batch: int, planes: int, threads: int):
    torch.manual_seed(0)
    size = (6, 10) if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d) else (planes, 6, 10)
    compare(layer, torch.randn(batch, layer.in_channels, *size))


@needs_kernel
def test_rows_of_an_odd_number_and_other_layouts_are_taken():
    layer = layout_channels_last(nn.Conv3d(4, 8, 3, 2, padding=1, bias=False))
    x = torch.randn(1, 4, 6, 7, 8).contiguous(memory_format=torch.channels_last_3d)
    compare(layer, x)
    compare(layer, x[..., 2:])


@needs_kernel
def test_the_gradient_of_the_weights_is_exact_in_integers():
    fine = torch.randint(-3, 4, (2, 4, 3, 4, 6)).float()
    coarse = torch.randint(-3, 4, (2, 8, 3, 4, 6)).float()
    expected = conv3d_weight(fine, [8, 4, 3, 3, 3], coarse, padding=1)
    assert torch.equal(weight_gradient(fine, coarse, stride=1), expected)


@needs_kernel
def test_what_needs_no_gradient_gets_none():
    layer = nn.Conv3d(4, 8, 3, padding=1, bias=False).requires_grad_(False)
    x = torch.randn(1, 4, 2, 4, 4, requires_grad=True)
    convolve(layer, x).sum().backward()
    assert x.grad is not None and layer.weight.grad is None


def test_other_layers_and_inputs_are_left_to_pytorch():
    x, layer = torch.randn(1, 8, 4, 4, 4), nn.Conv3d(8, 8, 3, padding=1, bias=False)
    for other in (
        nn.Conv3d(8, 8, 3, padding=1),
        nn.Conv3d(8, 8, 3, bias=False),
        nn.Conv3d(8, 8, 1, padding=1, bias=False),
        nn.Conv3d(8, 6, 3, padding=1, bias=False),
        nn.Conv3d(8, 8, 3, padding=1, bias=False, groups=2),
        nn.Conv3d(8, 8, 3, padding="same", bias=False),
        nn.Conv3d(8, 8, 3, padding=1, bias=False, padding_mode="circular"),
        nn.Conv3d(8, 8, 3, padding=1, bias=False, dilation=2),
        nn.ConvTranspose3d(8, 8, 3, 2, padding=1, bias=False),
    ):
        assert not fits_kernel(other, x)
    assert not fits_kernel(nn.Conv3d(8, 8, 3, 2, padding=1, bias=False), x[..., :3])
    assert not fits_kernel(layer, x.double())
    with torch.no_grad():
        assert not fits_kernel(layer, x)
    with torch.autocast("cpu", torch.bfloat16):
        assert not fits_kernel(layer, x)


@pytest.mark.parametrize("batch", [1, 2])
def test_a_regularizer_trains_the_same_without_the_kernel(batch: int, monkeypatch):
    torch.manual_seed(0)
    model = layout_channels_last(CostRegularizer(8)).train()
    volume = torch.rand(batch, 8, 8, 16, 16)

    def gradients() -> list[torch.Tensor]:
        scores = torch.softmax(model(volume), dim=1)
        return list(torch.autograd.grad(scores[:, 3].square().sum(), list(model.parameters())))

    fast = gradients()
    monkeypatch.setattr(convolution_gradient, "load_kernel", lambda source: None)
    assert not fits_kernel(Conv3d(8, 8, 3, padding=1, bias=False), volume)
    for ours, theirs in zip(fast, gradients(), strict=True):
        # Ten batch norms pass rounding on; those before the softmax cancel to almost nothing.
        torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=1e-3)


def test_a_picture_of_three_colours_is_left_to_pytorch():
    assert not fits_kernel(Conv2d(3, 8, 3, padding=1, bias=False), torch.rand(1, 3, 8, 8))
