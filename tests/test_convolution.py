import pytest
import torch
from torch import nn

from mvsam.convolution import convolve_by_onednn, fits_onednn, fold_batch_norm
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.weights import layout_channels_last
from tests.small import random_views, shuffle_statistics, small_model

LAYERS = {
    "2d": nn.Conv2d(3, 8, 5, 2, padding=2),
    "1x1": nn.Conv2d(3, 8, 1, bias=False),
    "3d": nn.Conv3d(3, 8, 3, padding=1, bias=False),
    "3d of stride 2": nn.Conv3d(3, 8, 3, 2, padding=1),
    "transposed": nn.ConvTranspose3d(3, 8, 3, 2, padding=1, output_padding=1, bias=False),
}


def picture_for(layer: nn.Module) -> torch.Tensor:
    return torch.randn(1, 3, 6, 8) if isinstance(layer, nn.Conv2d) else torch.randn(1, 3, 4, 6, 8)


@pytest.mark.parametrize("has_relu", [False, True])
@pytest.mark.parametrize("layer", LAYERS.values(), ids=LAYERS)
def test_one_dnn_gives_what_the_layer_gives(layer, has_relu: bool):
    x = picture_for(layer)
    expected = layer(x).detach()
    with torch.no_grad():
        assert fits_onednn(x)
        actual = convolve_by_onednn(layer, x, has_relu)
    torch.testing.assert_close(actual, expected.relu() if has_relu else expected)


def shaken(name: str):
    model = layout_channels_last(small_model(name)).eval()
    shuffle_statistics(model)
    return model


@pytest.mark.parametrize("name", ["cas_mvsnet", "tiny"])
def test_a_folded_model_predicts_the_same(name: str):
    model, views = shaken(name), random_views(height=64, width=64)
    folded = fold_batch_norm(model)
    assert not any(isinstance(m, nn.BatchNorm2d | nn.BatchNorm3d) for m in folded.modules())
    with torch.inference_mode():
        expected, actual = model(views), folded(views)
    torch.testing.assert_close(actual.depth, expected.depth, atol=1e-5, rtol=1e-5)
    if expected.logits is not None:
        torch.testing.assert_close(actual.logits, expected.logits, atol=1e-4, rtol=1e-4)


def test_folding_is_exact_to_rounding_in_every_score():
    model = CostRegularizer(8).eval()
    shuffle_statistics(model)
    volume = torch.rand(2, 8, 8, 16, 16)
    with torch.no_grad():
        expected, actual = model(volume), fold_batch_norm(model)(volume)
    torch.testing.assert_close(actual, expected, atol=1e-5, rtol=1e-5)


def test_folding_also_serves_where_one_dnn_is_not_called():
    model = CostRegularizer(8).eval()
    shuffle_statistics(model)
    volume = torch.rand(2, 8, 8, 16, 16)
    torch.testing.assert_close(fold_batch_norm(model)(volume), model(volume), atol=1e-5, rtol=1e-5)


def test_a_folded_model_in_bfloat16_is_near_float32():
    model = CostRegularizer(8).eval()
    shuffle_statistics(model)
    volume = torch.rand(1, 8, 8, 8, 8)
    with torch.no_grad():
        expected = model(volume)
        with torch.autocast("cpu", torch.bfloat16):
            actual = fold_batch_norm(model)(volume)
    assert actual.dtype == torch.bfloat16
    # Ten layers, each rounded to 8 bits.
    assert (actual.float() - expected).norm() < 0.05 * expected.norm()


def test_what_cannot_be_folded_is_left():
    reflecting = nn.Conv2d(3, 3, 3, padding=1, padding_mode="reflect")
    without_statistics = nn.BatchNorm2d(3, track_running_stats=False)
    for layers in (
        (reflecting, nn.BatchNorm2d(3)),
        (nn.Conv2d(3, 3, 3, padding="same"), nn.BatchNorm2d(3)),
        (nn.Conv2d(3, 3, 3), without_statistics),
        (nn.Conv2d(3, 3, 3), nn.ReLU(), nn.BatchNorm2d(3)),
    ):
        folded = fold_batch_norm(nn.Sequential(*layers))
        assert [type(layer) for layer in folded] == [type(layer) for layer in layers]


def test_folding_leaves_the_model_as_it_was_and_shares_its_other_weights():
    model = shaken("tiny").train()
    before = {key: value.clone() for key, value in model.state_dict().items()}
    folded = fold_batch_norm(model)
    assert model.training and not folded.training
    assert model.state_dict().keys() == before.keys()
    assert all(torch.equal(value, before[key]) for key, value in model.state_dict().items())
    assert all(parameter.requires_grad for parameter in model.parameters())
    own, theirs = dict(model.named_parameters()), {id(p) for p in folded.parameters()}
    assert id(own["cascade.regularizers.0.score.weight"]) in theirs
    assert id(own["cascade.regularizers.0.entry.0.weight"]) not in theirs


def test_one_dnn_is_not_called_for_gradients_low_precision_or_an_exported_graph():
    x, regularizer = torch.rand(1, 8, 8, 16, 16), CostRegularizer(8).eval()
    assert not fits_onednn(x)
    with torch.no_grad():
        assert not fits_onednn(x.double())
        with torch.autocast("cpu", torch.bfloat16):
            assert not fits_onednn(x)
        graph = torch.export.export(fold_batch_norm(regularizer), (x,)).graph
    assert not [node for node in graph.nodes if "mkldnn" in str(node.target)]
