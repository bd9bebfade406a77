from math import cos, exp, log, sin

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from mvsam.baselines.feature_matching import (
    FeatureMatchingTransformer,
    linear_attention,
    sine_position,
)
from mvsam.baselines.trans_mvsnet import (
    DeformableConv,
    TransMVSNet,
    TransMVSNetLoss,
    source_similarities,
    weighted_mean,
    winner_takes_all,
)
from mvsam.types import DepthStage, Prediction, Targets
from tests.baselines.counting import count
from tests.small import random_views

RANGE = torch.tensor([[0.1, 5.0]])


def test_each_part_has_the_released_number_of_parameters():
    with torch.device("meta"):
        model = TransMVSNet()
    assert count(model.pyramid) == 202_915
    assert count(model.pyramid.out_quarter) == 52_369
    assert (count(model.pyramid.out_half), count(model.pyramid.out_full)) == (55_937, 53_625)
    assert count(model.transformer) + count(model.pathway) == 71_872
    assert count(model.planes) == 3 * 291_312 and count(model.visibility) == 201


def test_a_deformable_convolution_begins_as_half_a_convolution_plus_bias():
    layer, x = DeformableConv(4, 6), torch.randn(2, 4, 7, 9)
    layer.bias.data.normal_()
    expected = 0.5 * F.conv2d(x, layer.weight, padding=1) + layer.bias[:, None, None]
    torch.testing.assert_close(layer(x), expected, atol=1e-5, rtol=1e-5)


def test_its_offsets_are_rows_then_columns_and_its_mask_comes_last():
    layer, x = DeformableConv(2, 3), torch.randn(1, 2, 8, 8)
    bias = layer.offset_and_mask.bias
    assert bias is not None
    bias.data[0:18:2] = 1.0  # every tap one row down
    bias.data[18:] = 20.0  # a sigmoid of one
    shifted = F.pad(x, (0, 0, 0, 1))[:, :, 1:]
    expected = F.conv2d(shifted, layer.weight, padding=1)
    torch.testing.assert_close(layer(x)[..., 1:-1, :], expected[..., 1:-1, :], atol=1e-5, rtol=1e-5)


def test_linear_attention_is_a_weighted_mean_of_the_values():
    query, key, value = (np.random.default_rng(i).normal(size=(5, 4)) for i in range(3))

    def phi(x: np.ndarray) -> np.ndarray:
        return np.where(x > 0, x + 1, np.exp(x))

    weights = phi(query) @ phi(key).T
    expected = weights / weights.sum(1, keepdims=True) @ value
    given = (torch.from_numpy(x)[None, None] for x in (query, key, value))
    np.testing.assert_allclose(linear_attention(*given)[0, 0], expected, atol=1e-5)


def test_positions_count_from_one_and_alternate_between_column_and_row():
    position = sine_position(32, height=3, width=4)
    second = exp(-log(10_000) * 2 / 16)
    expected = [sin(4), cos(4), sin(2), cos(2), sin(second * 4), cos(second * 4)]
    assert position[:6, 1, 3].tolist() == pytest.approx(expected, abs=1e-6)


def test_the_reference_is_transformed_without_a_look_at_the_sources():
    torch.manual_seed(0)
    transformer, features = FeatureMatchingTransformer(32), torch.randn(1, 3, 32, 4, 5)
    other = features.clone()
    other[:, 1] += 1
    with torch.no_grad():
        first, second = transformer(features), transformer(other)
    assert torch.equal(first[:, 0], second[:, 0]) and torch.equal(first[:, 2], second[:, 2])
    assert not torch.equal(first[:, 1], second[:, 1])


def test_similarity_to_the_same_view_is_the_mean_square_at_every_depth():
    views = random_views()
    views.world_from_cam[:] = torch.eye(4)
    features = torch.randn(1, 1, 32, 8, 16).expand(-1, 3, -1, -1, -1)
    hypotheses = torch.rand(1, 5, 8, 16) + 1
    for similarity in source_similarities(features, views, hypotheses):
        expected = features[:, 0].square().mean(1)[:, None, None].expand(-1, -1, 5, -1, -1)
        torch.testing.assert_close(similarity, expected, atol=1e-4, rtol=1e-4)


def test_a_single_view_is_refused():
    with pytest.raises(ValueError, match="needs a source view"):
        TransMVSNet()(random_views(num_views=1))


def test_views_of_no_weight_do_not_count():
    first, second = torch.randn(2, 1, 1, 4, 2, 2)
    weights = [torch.full((1, 1, 2, 2), w) for w in (0.5, 0.0)]
    torch.testing.assert_close(weighted_mean([first, second], weights), first, atol=1e-3, rtol=1e-3)
    nothing = weighted_mean([first, second], [weights[1], weights[1]])
    assert nothing.eq(0).all()


def test_the_winner_is_a_hypothesis_and_its_probability_the_confidence():
    scores = torch.log(torch.tensor([0.2, 0.7, 0.1]))[None, :, None, None].requires_grad_()
    stage = winner_takes_all(scores, torch.tensor([1.0, 2.0, 3.0])[None, :, None, None])
    assert stage.depth.item() == 2.0 and stage.confidence.item() == pytest.approx(0.7)
    assert not stage.depth.requires_grad and stage.probability.requires_grad


def one_stage(depths: list[list[float]], probabilities: list[float]) -> DepthStage:
    """A row of pixels for each list of true depths, all of the planes 1 m and 2 m."""
    size = (len(depths), 2, 1, len(depths[0]))
    hypotheses = torch.tensor([1.0, 2.0])[None, :, None, None].expand(size)
    probability = torch.tensor(probabilities)[None, :, None, None].expand(size)
    return DepthStage(hypotheses, probability, hypotheses[:, 0], hypotheses[:, 0])


def loss_of(depths: list[list[float]], loss: TransMVSNetLoss) -> float:
    depth = torch.tensor(depths)[:, None]
    targets = Targets(depth, torch.zeros_like(depth, dtype=torch.long))
    prediction = Prediction(stages=[one_stage(depths, [0.2, 0.8])])
    return loss(prediction, targets, RANGE.expand(len(depths), 2))["loss"].item()


ONE = TransMVSNetLoss(stage_weights=(1.0,))


def test_the_loss_is_the_cross_entropy_of_the_nearest_plane():
    assert loss_of([[1.9, 1.6]], ONE) == pytest.approx(-2 * log(0.8), abs=1e-4)
    assert loss_of([[1.1, 0.3]], ONE) == pytest.approx(-2 * log(0.2), abs=1e-4)
    assert loss_of([[4.9, 2.4]], ONE) == pytest.approx(-2 * log(0.8), abs=1e-4)


def test_easy_pixels_count_less_under_a_focus():
    focused = TransMVSNetLoss(focus=2.0, stage_weights=(1.0,))
    assert loss_of([[2.0, 2.0]], focused) == pytest.approx(-2 * 0.2**2 * log(0.8), abs=1e-4)


def test_the_mean_is_over_each_image_first_and_unknown_depth_does_not_count():
    expected = -(log(0.8) + log(0.2))
    assert loss_of([[2.0, 0.0], [1.0, 1.0]], ONE) == pytest.approx(expected, abs=1e-4)
    assert loss_of([[0.0, 9.0]], ONE) == 0
