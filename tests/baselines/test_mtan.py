from unittest import mock

import pytest
import torch
from torch import nn
from torchvision.models.resnet import Bottleneck, ResNet

from mvsam.baselines import mtan
from mvsam.baselines.backbones import DilatedResNet
from mvsam.baselines.imagenet import reference_image
from mvsam.baselines.mtan import Mtan
from tests.baselines.counting import count
from tests.small import random_views


@pytest.fixture(scope="module")
def small() -> Mtan:
    """Two blocks a stage."""
    torch.manual_seed(0)
    dilations = [False, True, True]
    network = ResNet(Bottleneck, [2, 2, 2, 2], replace_stride_with_dilation=dilations)
    with mock.patch.object(mtan, "resnet50", lambda _: (DilatedResNet(network), "random")):
        return Mtan(5).eval()


def test_parameters_are_those_of_the_release():
    with torch.device("meta"):
        model = Mtan()
    assert count(model) == 72_047_573
    stages = zip(*model.attention.values(), strict=True)
    both_tasks = [sum(count(mask) for mask in masks) for masks in stages]
    assert both_tasks == [67_456, 397_056, 1_580_544, 6_306_816]
    assert [count(part) for part in model.refinement] == [379_392, 1_512_448, 6_039_552]
    assert {task: count(head) for task, head in model.head.items()} == {
        "semantics": 16_130_580,
        "depth": 16_125_697,
    }


def test_a_mask_of_ones_hands_the_shared_features_to_the_head(small: Mtan):
    views, seen = random_views(num_views=1), {}
    last = small.attention["depth"][-1]  # pyright: ignore
    nn.init.zeros_(last[-2].weight)
    nn.init.constant_(last[-2].bias, 100.0)
    small.head["depth"].register_forward_pre_hook(lambda _, inputs: seen.update(depth=inputs[0]))
    with torch.no_grad():
        small(views)
        expected = small.backbone(reference_image(views))
    torch.testing.assert_close(seen["depth"], expected)


def test_a_mask_of_one_task_leaves_the_other_alone(small: Mtan):
    views = random_views(num_views=1)
    with torch.no_grad():
        before = small(views)
        small.attention["semantics"][0][-2].bias += 1.0  # pyright: ignore
        after = small(views)
    assert torch.equal(before.depth, after.depth)
    assert not torch.equal(before.logits, after.logits)
