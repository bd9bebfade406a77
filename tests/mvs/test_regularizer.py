import subprocess
import sys
from functools import partial

import pytest
import torch
from torch import nn

from mvsam.mvs import regularizer
from mvsam.mvs.regularizer import Conv3d, ConvTranspose3d, CostRegularizer, ScoreConv3d

TRAINING_SHAPES = {
    "a coarse volume at its bottom": (2, 64, 2, 8, 10),
    "half-size fine": (2, 8, 8, 128, 160),
    "odd size": (2, 8, 8, 160, 192),
}
FULL_SIZE_SHAPES = {
    "middle": (2, 16, 16, 128, 160),
    "coarse": (2, 32, 48, 64, 80),
    "fine": (2, 8, 8, 256, 320),
}


@pytest.mark.parametrize(
    "channels, count", [(32, 298_008), (16, 294_552), (8, 292_824)], ids=["1/4", "1/2", "1/1"]
)
def test_parameters_are_those_of_cas_mvsnet(channels: int, count: int):
    with torch.device("meta"):
        model = CostRegularizer(channels)
    assert sum(p.numel() for p in model.parameters()) == count


def test_one_score_comes_for_each_plane_and_pixel():
    assert CostRegularizer(8).eval()(torch.randn(2, 8, 16, 24, 32)).shape == (2, 16, 24, 32)


def gradients(layer, volume: torch.Tensor, dtype: torch.dtype) -> list[torch.Tensor]:
    layer.zero_grad()
    volume = volume.clone().requires_grad_()
    with torch.autocast("cpu", dtype, enabled=dtype != torch.float32):
        result = layer(volume)
    result.float().square().sum().backward()
    assert volume.grad is not None
    return [result.detach().float(), volume.grad, layer.weight.grad]


@pytest.mark.parametrize("stride", [1, 2])
def test_bfloat16_convolution_of_two_planes_is_near_float32(stride: int):
    torch.manual_seed(0)
    layer, volume = Conv3d(64, 64, 3, stride, padding=1), torch.randn(2, 64, 2, 8, 10)
    narrow = gradients(layer, volume, torch.bfloat16)
    wide = gradients(layer, volume, torch.float32)
    for actual, expected in zip(narrow, wide, strict=True):
        assert actual.isfinite().all()
        # bfloat16 keeps 8 bits; what the bug returned was wrong by orders of magnitude.
        assert (actual - expected).norm() < 0.02 * expected.norm()


def test_only_training_pays_for_the_step_around():
    volume = torch.randn(1, 4, 2, 4, 4)
    with torch.autocast("cpu", torch.bfloat16):
        assert Conv3d(4, 4, 3, padding=1)(volume).dtype == torch.float32
        with torch.no_grad():
            assert Conv3d(4, 4, 3, padding=1)(volume).dtype == torch.bfloat16


def train_in_another_process(shapes) -> None:
    """Memory that the faulty backward pass corrupts must not be this process's."""
    script = f"""
import torch
from mvsam.mvs.regularizer import Conv3d, ConvTranspose3d, CostRegularizer, ScoreConv3d
from mvsam.weights import layout_channels_last
torch.set_num_threads(1)
for shape in {list(shapes)}:
    channels = shape[1]
    layers = [CostRegularizer(channels)] if channels < 64 else [Conv3d(64, 64, 3, padding=1)]
    layers += [Conv3d(channels, 16, 3, 2, 1)]
    for layer in layers:
        layout_channels_last(layer)
        volume = torch.randn(shape).contiguous(memory_format=torch.channels_last_3d)
        volume.requires_grad_()
        with torch.autocast("cpu", torch.bfloat16):
            out = layer(volume.bfloat16())
        out.float().square().mean().backward()
        assert volume.grad.isfinite().all() and out.isfinite().all()
        assert all(p.grad.isfinite().all() for p in layer.parameters())
print("done")
"""
    result = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0 and "done" in result.stdout, result.stderr[-2000:]


def test_bfloat16_training_survives_the_shapes_of_training():
    train_in_another_process(TRAINING_SHAPES.values())


@pytest.mark.slow
def test_bfloat16_training_survives_full_size_shapes():
    train_in_another_process(FULL_SIZE_SHAPES.values())


def test_whole_regularizer_in_bfloat16_is_near_float32():
    torch.manual_seed(0)
    model, volume = CostRegularizer(16).train(), torch.rand(2, 16, 16, 16, 24)

    def gradient(dtype) -> torch.Tensor:
        model.zero_grad()
        with torch.autocast("cpu", dtype, enabled=dtype != torch.float32):
            scores = model(volume)
        torch.softmax(scores.float(), 1)[:, 3].sum().backward()
        return torch.cat([p.grad.flatten() for p in model.parameters() if p.grad is not None])

    narrow, wide = gradient(torch.bfloat16), gradient(torch.float32)
    assert narrow.isfinite().all()
    # Ten layers of 8-bit rounding: the direction of the step is what has to survive.
    assert torch.cosine_similarity(narrow, wide, dim=0) > 0.97


def test_the_plane_limit_follows_the_processor(monkeypatch):
    regularizer._fewest_bfloat16_planes.cache_clear()
    monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: True)
    assert regularizer._fewest_bfloat16_planes() == 9
    regularizer._fewest_bfloat16_planes.cache_clear()
    monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: False)
    assert regularizer._fewest_bfloat16_planes() == 3
    regularizer._fewest_bfloat16_planes.cache_clear()


@pytest.mark.parametrize("num_planes", [1, 2, 9])
def test_scores_by_planes_are_those_of_the_3d_convolution(num_planes: int):
    layer = ScoreConv3d(8)
    volume = torch.randn(2, 8, num_planes, 6, 7)
    torch.testing.assert_close(layer(volume), nn.Conv3d.forward(layer, volume))


@pytest.mark.parametrize("kind", ["down", "same", "up"])
def test_training_on_one_volume_has_the_gradients_of_plain_pytorch(kind: str):
    layer = {
        "down": Conv3d(4, 6, 3, 2, padding=1),
        "same": Conv3d(4, 6, 3, padding=1, bias=False),
        "up": ConvTranspose3d(4, 6, 3, 2, padding=1, output_padding=1),
    }[kind]
    plain = type(layer).__mro__[1].forward
    volume = torch.randn(1, 4, 4, 6, 8)
    actual = gradients(layer, volume, torch.float32)
    layer.forward = partial(plain, layer)  # pyright: ignore[reportAttributeAccessIssue]
    expected = gradients(layer, volume, torch.float32)
    for ours, theirs in zip(actual, expected, strict=True):
        torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=1e-4)
