import torch
from torch import nn

from mvsam.baselines.imagenet import reference_image
from mvsam.baselines.segnet import SegNet
from tests.baselines.counting import count
from tests.small import random_views


def test_parameters_are_those_of_the_published_network():
    with torch.device("meta"):
        model, fewer = SegNet(20), SegNet(11)
    assert count(model) == 29_454_548 and count(fewer) == 29_449_355
    assert count(model.encoder) == 14_723_136
    assert count(model.decoder) == 14_719_872
    assert count(model.head) == 577 * 20


def test_every_maximum_returns_to_where_it_was():
    views = random_views(num_views=1, height=48, width=70)
    with torch.device("meta"):  # no layer with weights is left
        model = SegNet().eval()
    pools = [module for module in model.encoder if isinstance(module, nn.MaxPool2d)]
    model.encoder = nn.Sequential(*pools)
    model.decoder = nn.ModuleList(nn.Identity() for _ in pools)
    model.head = nn.Identity()  # pyright: ignore
    image = reference_image(views)[0]
    logits = model(views).logits[0]
    for channel in range(3):
        for columns in (slice(0, 32), slice(32, 64)):
            block, kept = image[channel, :32, columns], logits[channel, :32, columns]
            assert kept.nonzero().tolist() == (block == block.max()).nonzero().tolist()
    assert logits[:, 32:].eq(0).all() and logits[:, :, 64:].eq(0).all()
