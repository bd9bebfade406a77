from pathlib import Path

import pytest
import timm
import torch
from safetensors.torch import save_file
from torch import nn
from torchvision import models

from mvsam.baselines.backbones import (
    DilatedResNet,
    hrnet_w18_small_v2,
    mobilenet_v2,
    resnet50,
    resnet101,
    vgg16,
)
from mvsam.baselines.imagenet import DOWNLOAD, load_imagenet, reference_image
from mvsam.errors import InputError
from tests.small import random_views, shuffle_statistics


def no_network() -> dict[str, torch.Tensor]:
    raise ConnectionError("no route to host")


def network(seed: int = 0) -> nn.Sequential:
    torch.manual_seed(seed)
    return nn.Sequential(nn.Conv2d(3, 4, 1), nn.BatchNorm2d(4))


def test_view_0_is_normalised_by_imagenet_s_mean_and_deviation():
    views = random_views(num_views=2)
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    expected = (views.images[0, 0, :, 3, 5] - mean) / std
    torch.testing.assert_close(reference_image(views)[0, :, 3, 5], expected)


def test_sides_that_do_not_divide_are_named():
    with pytest.raises(ValueError, match="divisible by 32, not 64 x 40"):
        reference_image(random_views(height=40, width=64), divisor=32)


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_a_local_file_is_begun_from_and_named_whatever_else_it_holds(tmp_path: Path, suffix: str):
    released, ours = network(1), network(2)
    state = {f"features.{k}": v for k, v in released.state_dict().items()}
    state["classifier.weight"] = torch.zeros(1)
    path = tmp_path / f"released{suffix}"
    save_file(state, path) if suffix == ".safetensors" else torch.save(state, path)
    assert load_imagenet(ours, str(path), no_network, "features.") == path.name
    torch.testing.assert_close(ours[0].weight, released[0].weight)


def test_what_the_model_says_it_began_with():
    assert load_imagenet(network(), None, no_network) == "random"
    assert load_imagenet(network(), DOWNLOAD, lambda: network(1).state_dict()) == "imagenet"


def test_without_a_network_the_error_asks_for_a_file(tmp_path: Path):
    with pytest.raises(InputError, match=r"'download' is not to be had.*path of a downloaded file"):
        load_imagenet(network(), DOWNLOAD, no_network)
    with pytest.raises(InputError, match=r"none\.pth' is not to be had"):
        load_imagenet(network(), str(tmp_path / "none.pth"), no_network)


def test_another_network_s_weights_are_refused(tmp_path: Path):
    torch.save({"0.weight": torch.zeros(5)}, tmp_path / "other.pth")
    with pytest.raises(InputError, match=r"6 of 6 entries.*first: 0\.weight"):
        load_imagenet(network(), str(tmp_path / "other.pth"), no_network)
    (tmp_path / "broken.pth").write_bytes(b"not weights")
    with pytest.raises(InputError, match="not a readable weights file"):
        load_imagenet(network(), str(tmp_path / "broken.pth"), no_network)


@pytest.mark.parametrize(
    "backbone, count",
    [
        (hrnet_w18_small_v2, 3_860_720),
        (mobilenet_v2, 1_812_800),
        (resnet50, 23_508_032),
        (resnet101, 42_500_160),
        (vgg16, 14_723_136),
    ],
)
def test_backbones_have_the_published_parameters(backbone, count: int):
    with torch.device("meta"):
        module, weights = backbone()
    assert sum(p.numel() for p in module.parameters()) == count
    assert weights == "random"


@pytest.mark.parametrize(
    "backbone, released, prefix",
    [
        (hrnet_w18_small_v2, lambda: timm.create_model("hrnet_w18_small_v2"), ""),
        (vgg16, models.vgg16_bn, "features."),
    ],
)
def test_backbones_are_found_by_name_in_the_released_classifiers(backbone, released, prefix: str):
    with torch.device("meta"):
        (module, _), whole = backbone(), released().state_dict()
    for name, value in module.state_dict().items():
        assert whole[prefix + name].shape == value.shape


def test_hrnet_s_branches_meet_bilinearly_at_four_scales():
    module, _ = hrnet_w18_small_v2()
    shapes = [x.shape for x in module(torch.rand(1, 3, 64, 96))]
    assert shapes == [(1, 18, 16, 24), (1, 36, 8, 12), (1, 72, 4, 6), (1, 144, 2, 3)]
    upsampled = [m for m in module.modules() if isinstance(m, nn.Upsample)]
    assert upsampled and {m.mode for m in upsampled} == {"bilinear"}
    norms = [m for m in module.modules() if isinstance(m, nn.BatchNorm2d)]
    assert {m.momentum for m in norms} == {0.01}


def test_the_expansion_torchvision_leaves_out_changes_nothing_at_first(tmp_path: Path):
    torch.manual_seed(0)
    released = models.mobilenet_v2().eval()
    shuffle_statistics(released)
    torch.save(released.state_dict(), tmp_path / "mobilenet.pth")
    features, weights = mobilenet_v2(str(tmp_path / "mobilenet.pth"))
    assert weights == "mobilenet.pth"
    images = torch.rand(1, 3, 64, 64)
    with torch.no_grad():
        expected = released.features[:18](images)
        actual = features.eval()(images)
    # A fresh batch norm divides by sqrt(1 + 1e-5).
    torch.testing.assert_close(actual, expected, rtol=1e-3, atol=1e-4)


def test_dilated_stages_keep_an_eighth_of_the_picture():
    network = models.ResNet(
        models.resnet.Bottleneck, [1, 1, 1, 1], replace_stride_with_dilation=[False, True, True]
    )
    assert DilatedResNet(network)(torch.rand(1, 3, 64, 96)).shape == (1, 2048, 8, 12)
