import pytest
import torch
import torch.nn.functional as F
from torchvision.models._utils import IntermediateLayerGetter
from torchvision.models.resnet import Bottleneck, ResNet
from torchvision.models.segmentation import DeepLabV3 as TorchvisionDeepLabV3
from torchvision.models.segmentation.deeplabv3 import DeepLabHead

from mvsam.baselines import deeplab
from mvsam.baselines.backbones import DilatedResNet
from mvsam.baselines.deeplab import DeepLabV2, DeepLabV3, SummedDilations
from mvsam.baselines.imagenet import reference_image
from tests.baselines.counting import count
from tests.small import random_views, shuffle_statistics


@pytest.fixture
def network(monkeypatch) -> ResNet:
    """One block a stage, in the place of ResNet-101; said to be pre-trained where asked for."""
    torch.manual_seed(0)
    dilations = [False, True, True]
    network = ResNet(Bottleneck, [1, 1, 1, 1], replace_stride_with_dilation=dilations).eval()
    shuffle_statistics(network)
    monkeypatch.setattr(
        deeplab, "resnet101", lambda imagenet: (DilatedResNet(network), imagenet or "random")
    )
    return network


def test_parameters_are_those_of_the_published_networks():
    with torch.device("meta"):
        v2, v3 = DeepLabV2(), DeepLabV3()
    assert count(v2) == 43_974_800 and count(v2.head) == 1_474_640
    assert count(v3) == 58_630_740 and count(v3.head) == 16_130_580


def test_deeplab_v3_equals_torchvision_s_with_equal_weights(network: ResNet):
    head = DeepLabHead(2048, 5).eval()
    theirs = TorchvisionDeepLabV3(IntermediateLayerGetter(network, {"layer4": "out"}), head)
    ours, views = DeepLabV3(5).eval(), random_views(num_views=1)
    ours.head.load_state_dict(head.state_dict())
    with torch.no_grad():
        torch.testing.assert_close(ours(views).logits, theirs(reference_image(views))["out"])


def test_deeplab_v2_s_head_adds_up_four_dilations():
    torch.manual_seed(0)
    head, x = SummedDilations(3, 2), torch.rand(1, 3, 60, 60)
    expected = torch.zeros(2)
    for convolution, rate in zip(head.convolutions, (6, 12, 18, 24), strict=True):
        weight, bias = convolution.parameters()
        assert bias.eq(0).all() and 0.005 < weight.std() < 0.02
        torch.nn.init.normal_(bias)
        taps = x[0, :, 30 - rate : 31 + rate : rate, 30 - rate : 31 + rate : rate]
        expected += (weight * taps).sum((1, 2, 3)) + bias
    torch.testing.assert_close(head(x)[0, :, 30, 30], expected)


def test_logits_come_from_an_eighth_of_the_picture(network: ResNet):
    model, views = DeepLabV2(5).eval(), random_views(num_views=1)
    with torch.no_grad():
        coarse = model.head(model.backbone(reference_image(views)))
        assert coarse.shape == (1, 5, 4, 8)
        expected = F.interpolate(coarse, (32, 64), mode="bilinear", align_corners=False)
        torch.testing.assert_close(model(views).logits, expected)


def test_released_batch_norms_stay_as_they_are_in_deeplab_v2(network: ResNet):
    before = network.state_dict()["bn1.running_mean"].clone()
    pretrained = DeepLabV2(5, imagenet="download").train()
    pretrained(random_views(batch=2, num_views=1))
    assert torch.equal(network.state_dict()["bn1.running_mean"], before)
    assert not network.bn1.weight.requires_grad and network.conv1.weight.requires_grad
    network.requires_grad_(True)
    DeepLabV2(5).train()(random_views(batch=2, num_views=1))
    assert not torch.equal(network.state_dict()["bn1.running_mean"], before)


def test_the_head_of_deeplab_v2_learns_faster_and_its_biases_undecayed(network: ResNet):
    groups = DeepLabV2(5, imagenet="download").parameter_groups(1.0)
    assert [group["lr"] for group in groups] == [1.0, 10.0, 20.0]
    assert groups[2]["weight_decay"] == 0 and {p.dim() for p in groups[2]["params"]} == {1}
    assert all(p.requires_grad for group in groups for p in group["params"])
