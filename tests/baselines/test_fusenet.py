import pytest
import torch
from torch import nn

from mvsam.baselines import fusenet
from mvsam.baselines.fusenet import FuseNet, depth_in_bytes
from tests.baselines.counting import count
from tests.small import random_views


def test_parameters_are_those_of_the_release():
    with torch.device("meta"):
        model = FuseNet(20)
    assert count(model) == 44_176_532
    assert count(model.depth_encoder[0]) == 640
    blocks = (37_184, 221_952, 1_476_864, 5_902_848, 7_082_496)
    assert count(model.depth_encoder) == 640 + sum(blocks)
    decoder = (7_082_496, 5_902_080, 1_476_480, 221_760, 48_596)
    assert count(model.decoder) + count(model.head) == sum(decoder)


@pytest.fixture
def narrow(monkeypatch) -> FuseNet:
    """One convolution of the picture's three channels, then five poolings and nothing else."""

    def encoder(imagenet: str | None) -> tuple[nn.Sequential, str]:
        layers = (nn.Conv2d(3, 3, 3, padding=1), *(nn.MaxPool2d(2) for _ in range(5)))
        return nn.Sequential(*layers), imagenet or "random"

    monkeypatch.setattr(fusenet, "vgg16", encoder)
    with torch.device("meta"):
        model = FuseNet(3)
    model = model.to_empty(device="cpu")
    model.decoder = nn.ModuleList(nn.Identity() for _ in range(5))
    model.head = nn.Identity()  # pyright: ignore
    return model


def test_depth_is_added_before_every_pooling_and_maxima_return(narrow: FuseNet):
    torch.manual_seed(0)
    for parameter in narrow.parameters():
        nn.init.normal_(parameter)
    views = random_views(num_views=1, measured=True)
    with torch.no_grad():
        color = narrow.color_encoder[0](fusenet.reference_image(views))
        depth = narrow.depth_encoder[0](depth_in_bytes(views))
        logits = narrow.eval()(views).logits
        for _ in range(5):
            color, depth = (nn.functional.max_pool2d(x, 2) for x in (color + depth, depth))
    assert logits is not None
    kept = [logits[0, :, :, :32], logits[0, :, :, 32:]]
    for column, half in enumerate(kept):
        assert half.ne(0).sum((-2, -1)).tolist() == [1, 1, 1]
        torch.testing.assert_close(half.sum((-2, -1)), color[0, :, 0, column])


def test_dropout_is_at_the_three_coarsest_scales_down_and_up(narrow: FuseNet):
    for parameter in narrow.parameters():
        nn.init.ones_(parameter)
    sizes = []
    narrow.dropout = nn.Identity()  # pyright: ignore
    narrow.dropout.register_forward_hook(lambda module, x, y: sizes.append(x[0].shape[-1]))
    narrow(random_views(num_views=1, width=64, measured=True))
    assert sizes == [8, 8, 4, 4, 2, 2, 4, 8, 16]


def test_the_depth_s_first_weights_are_the_mean_over_the_colours():
    color = nn.Conv2d(3, 4, 3, padding=1)
    depth = fusenet._for_one_channel(color)
    torch.testing.assert_close(depth.weight[:, 0], color.weight.sum(1) / 3)
    assert torch.equal(depth.bias, color.bias)  # pyright: ignore


def test_depth_is_read_as_bytes_of_the_range():
    views = random_views(num_views=1, measured=True)
    assert views.measured_depth is not None
    views.measured_depth[0, 0, :3] = torch.tensor([0.0, 2.5, 9.0])
    assert depth_in_bytes(views)[0, 0, 0, :3].tolist() == [0.0, 127.5, 255.0]
