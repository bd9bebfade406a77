import numpy as np
import torch

from mvsam.baselines.mti_net import FeaturePropagation, MtiNet
from tests.baselines.counting import count
from tests.small import random_views


def test_parameters_are_those_of_the_release():
    with torch.device("meta"):
        model = MtiNet()
    assert count(model) == 8_567_279
    assert [count(part) for part in model.initial] == [37_695, 149_241, 593_949, 1_498_341]
    assert [count(part) for part in model.propagation] == [61_420, 244_592, 976_770]
    assert [count(part) for part in model.distillation] == [11_664, 46_656, 186_624, 746_496]
    assert count(model.fusion) + count(model.head) == 153_111


def test_initial_predictions_come_along_finest_first():
    with torch.no_grad():
        prediction = MtiNet(5).eval()(random_views(num_views=1))
    depths = [side.depth for side in prediction.auxiliary]
    sizes = [None if depth is None else tuple(depth.shape) for depth in depths]
    assert sizes == [(1, 8, 16), (1, 4, 8), (1, 2, 4), (1, 1, 2)]
    assert prediction.logits is not None and prediction.logits.shape == (1, 5, 32, 64)


def test_propagation_weighs_neighbouring_channels_against_each_other():
    torch.manual_seed(0)
    part, seen = FeaturePropagation(16).eval(), {}
    part.attention.register_forward_hook(lambda module, inputs, out: seen.update(raw=out))
    part.shared.register_forward_hook(
        lambda module, inputs, out: seen.update(weighted=inputs[0], shared=out)
    )
    features = {"semantics": torch.rand(1, 16, 2, 2), "depth": torch.rand(1, 16, 2, 2)}
    with torch.no_grad():
        passed = part(features)
    raw = seen["raw"].double().numpy()
    stacked = np.concatenate([features["semantics"], features["depth"]], axis=1)
    for channel in range(32):
        partner = channel ^ 1
        share = 1 / (1 + np.exp(raw[:, partner] - raw[:, channel]))
        np.testing.assert_allclose(
            seen["weighted"][:, channel], stacked[:, channel] * share, rtol=1e-5
        )
    for task, own in features.items():
        gate = part.gate[task]
        torch.testing.assert_close(passed[task], own + gate(seen["shared"]))


def test_coarse_scales_inform_finer_ones_and_not_the_other_way():
    torch.manual_seed(0)
    model, views = MtiNet(5).eval(), random_views(num_views=1)
    with torch.no_grad():
        before = model(views).auxiliary
        model.initial[2].features["depth"][-1].bn2.bias += 1.0  # pyright: ignore
        after = model(views).auxiliary
    changed = [not torch.equal(a.logits, b.logits) for a, b in zip(before, after, strict=True)]
    assert changed == [True, True, False, False]  # at 1/16 only depth itself changed
    assert not torch.equal(before[2].depth, after[2].depth)
    assert torch.equal(before[3].depth, after[3].depth)
