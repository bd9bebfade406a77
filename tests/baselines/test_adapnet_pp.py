import pytest
import torch
from torch import nn

from mvsam.baselines.adapnet_pp import AdapNetPP, AdapNetPPLoss, MultiRate
from mvsam.types import IGNORE, Prediction, Targets
from tests.baselines.counting import count
from tests.small import random_views


def test_parameters_are_those_of_the_published_network():
    with torch.device("meta"):
        model, fewer = AdapNetPP(20), AdapNetPP(12)
    encoder, side_heads = model.encoder, model.decoder.auxiliary_heads
    assert count(encoder) == 25_562_918 and count(encoder.pyramid) == 2_044_032
    assert count(encoder.stem) == 6 + 9_536
    activations = (512, 1_024, 2_048, 4_096)
    units = (214_784, 1_217_536, 7_094_272, 14_958_592 - 2_048)
    parts = [sum(pair) for pair in zip(units, activations, strict=True)]
    assert [count(block) for block in encoder.blocks] == parts
    assert [count(skip) for skip in encoder.skips] == [6_192, 12_336]
    assert count(side_heads) == 10_320 and count(model.decoder) - 10_320 == 4_600_912
    assert count(model) - 10_320 == 30_163_830
    statistics = sum(b.numel() for n, b in fewer.named_buffers() if n.endswith(("mean", "var")))
    without_heads = count(fewer) - count(fewer.decoder.auxiliary_heads)
    assert without_heads == 30_145_366
    heads_statistics = 2 * 2 * 12
    assert without_heads + statistics - heads_statistics == 30_198_252  # published: 30.20 M


@pytest.fixture(scope="module")
def model() -> AdapNetPP:
    torch.manual_seed(0)
    return AdapNetPP(5).eval()


def test_side_outputs_are_at_a_quarter_and_an_eighth(model: AdapNetPP):
    with torch.no_grad():
        prediction = model(random_views(num_views=1))
    shapes = [side.logits.shape for side in prediction.auxiliary if side.logits is not None]
    assert shapes == [(1, 5, 8, 16), (1, 5, 4, 8)]
    assert prediction.logits is not None and prediction.logits.shape == (1, 5, 32, 64)


def test_the_encoder_s_strides_begin_at_the_first_pixel_as_tensorflow_s_do(model: AdapNetPP):
    """SAME with stride 2: 7x7 begins two pixels outside, 3x3 inside the picture."""
    stem = model.encoder.stem
    convolution = next(m for m in stem if isinstance(m, nn.Conv2d))
    x = torch.rand(1, 3, 8, 12)
    with torch.no_grad():
        activated = stem[:5](x)
        norm = stem[3]
        padded = nn.functional.pad(stem[0](x), (2, 3, 2, 3))
        expected = norm(nn.functional.conv2d(padded, convolution.weight, stride=2)).relu()
        torch.testing.assert_close(activated, expected)
        pooled = stem(x)
    assert pooled.shape == (1, 64, 2, 3)
    torch.testing.assert_close(pooled[..., 0, 0], activated[..., :3, :3].amax((-2, -1)))


def test_a_multi_rate_convolution_sees_two_scales_with_half_its_channels_each():
    torch.manual_seed(0)
    layer, x = MultiRate(4, rates=(1, 2), stride=1).eval(), torch.rand(1, 4, 9, 9)
    x.requires_grad_(True)
    for half, reach in ((slice(0, 2), 1), (slice(2, 4), 2)):
        for parameter in layer.parameters():
            nn.init.ones_(parameter) if parameter.dim() > 1 else None
        (gradient,) = torch.autograd.grad(layer(x)[0, half, 4, 4].sum(), x)
        rows = gradient[0, 0, :, 4].nonzero().flatten().tolist()
        assert rows == [4 - reach, 4, 4 + reach]


def test_loss_adds_six_and_five_tenths_of_the_side_outputs():
    labels = torch.tensor([[[0, 1], [IGNORE, 1]]])
    even, sure = torch.zeros(1, 2, 1, 1), torch.zeros(1, 2, 2, 2)
    sure[0, 0], sure[0, 1] = torch.tensor([[50.0, 0], [0, 0]]), torch.tensor([[0, 50.0], [0, 50.0]])
    prediction = Prediction(
        logits=sure, auxiliary=(Prediction(logits=even), Prediction(logits=sure))
    )
    targets = Targets(torch.zeros(1, 2, 2), labels)
    parts = AdapNetPPLoss()(prediction, targets, torch.tensor([[0.1, 5.0]]))
    assert parts["segmentation"].item() == pytest.approx(0, abs=1e-6)
    assert parts["loss"].item() == pytest.approx(0.6 * 0.693147, abs=1e-5)
