import pytest
import torch
from torch import nn

from mvsam.baselines.emsaformer import (
    EmsaFormer,
    EmsaFormerLoss,
    Encoder,
    PyramidPooling,
    SplitPatches,
)
from mvsam.baselines.emsaformer_decoders import (
    EmsaNetDecoder,
    Enlargement,
    FactoredBlock,
    MlpDecoder,
)
from mvsam.types import IGNORE, Prediction, Targets
from tests.baselines.counting import count
from tests.small import random_views


def test_parameters_are_those_of_the_release_part_by_part():
    with torch.device("meta"):
        assert count(Encoder()) == 48_959_288 and count(SplitPatches()) == 4_896 + 608
        assert count(PyramidPooling(1024)) == 3_149_824
        assert count(EmsaNetDecoder(20)) == 18_649_568
        assert count(MlpDecoder(20)) == 443_812


def skips_at(height: int, width: int) -> list[torch.Tensor]:
    """Of a picture of that size, as the encoder gives them."""
    return [
        torch.rand(1, height // scale, width // scale, channels)
        for scale, channels in ((4, 128), (8, 256), (16, 512))
    ]


def test_side_outputs_are_at_the_three_coarsest_scales():
    context = torch.rand(1, 1024, 1, 2)
    with torch.no_grad():
        prediction = EmsaNetDecoder(3).eval()(context, skips_at(32, 64))
        light = MlpDecoder(3).eval()(context, skips_at(32, 64))
    shapes = [side.logits.shape for side in prediction.auxiliary if side.logits is not None]
    assert shapes == [(1, 3, 1, 2), (1, 3, 2, 4), (1, 3, 4, 8)]
    assert prediction.logits.shape == light.logits.shape == (1, 3, 32, 64)
    assert light.auxiliary == ()


def test_patches_keep_picture_and_depth_apart():
    torch.manual_seed(0)
    patches, image, depth = SplitPatches(), torch.rand(1, 3, 8, 8), torch.rand(1, 1, 8, 8)
    with torch.no_grad():
        tokens, other = patches(image, depth), patches(image, depth.flip(-1))
    assert torch.equal(tokens[..., :96], other[..., :96])
    assert not torch.allclose(tokens[..., 96:], other[..., 96:])
    torch.testing.assert_close(tokens[..., :96].mean(-1), torch.zeros(1, 2, 2), atol=1e-6, rtol=0)


def test_enlargement_begins_as_a_blur_that_keeps_a_plane():
    x = torch.zeros(1, 1, 3, 3)
    x[0, 0, 1, 1] = 16.0
    rows = torch.tensor([0.0, 1, 3, 3, 1, 0])  # [1, 1] blurred by [1, 2, 1]
    with torch.no_grad():
        torch.testing.assert_close(Enlargement(1)(x)[0, 0], torch.outer(rows, rows))
        plane = Enlargement(1)(torch.ones(1, 1, 4, 4))[0, 0, 1:-1, 1:-1]
    torch.testing.assert_close(plane, torch.ones(6, 6))


def test_a_factored_block_begins_as_the_identity():
    block, x = FactoredBlock(4).eval(), torch.rand(1, 4, 5, 5)
    assert torch.equal(block(x), x)
    kernels = [m.kernel_size for m in block.modules() if isinstance(m, nn.Conv2d)]
    assert kernels == [(3, 1), (1, 3), (3, 1), (1, 3)]


class KeepsDepth(nn.Module):
    """In the encoder's place: what depth it is given."""

    def forward(self, image: torch.Tensor, depth: torch.Tensor) -> list[torch.Tensor]:
        self.depth = depth
        return [image.movedim(1, -1)]


class SaysNothing(nn.Module):
    """In the decoder's place."""

    def forward(self, context: torch.Tensor, skips: list[torch.Tensor]) -> Prediction:
        return Prediction()


def test_unknown_depth_counts_as_the_mean():
    with torch.device("meta"):
        model = EmsaFormer(3, SaysNothing())
    model.context = nn.Identity()  # pyright: ignore
    model.encoder = encoder = KeepsDepth()  # pyright: ignore
    views = random_views(num_views=1, measured=True)
    assert views.measured_depth is not None
    views.measured_depth[0, 0, :3] = torch.tensor([0.0, 2.0, 4.5])
    model(views)
    assert encoder.depth[0, 0, 0, :3].tolist() == [0.0, 0.0, 2.5]


def test_loss_supervises_side_outputs_at_their_scale():
    labels = torch.tensor([[[0, 0, 1, 1], [0, 0, 1, 1], [IGNORE] * 4, [IGNORE] * 4]])
    right = torch.full((1, 2, 2, 2), -50.0)
    right[0, 0, :, 0] = right[0, 1, :, 1] = 50.0
    even = torch.zeros(1, 2, 4, 4)
    prediction = Prediction(logits=even, auxiliary=(Prediction(logits=right),))
    targets = Targets(torch.zeros(1, 4, 4), labels)
    parts = EmsaFormerLoss()(prediction, targets, torch.tensor([[0.1, 5.0]]))
    assert parts["segmentation"].item() == pytest.approx(0.693147, abs=1e-5)
    assert parts["auxiliary"].item() == pytest.approx(0, abs=1e-6)
    assert parts["loss"].item() == pytest.approx(0.693147, abs=1e-5)
