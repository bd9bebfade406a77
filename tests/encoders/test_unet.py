import sys

import pytest
import torch

from mvsam.encoders.fpn import FeaturePyramid
from mvsam.encoders.unet import UNetPyramid, decoder_levels, normalize, unet
from mvsam.errors import MissingExtraError


@pytest.fixture(scope="module")
def network() -> torch.nn.Module:
    torch.manual_seed(0)
    return unet("resnet34", 20).eval()


def test_decoder_levels_end_with_what_the_library_s_own_decoder_gives(network):
    with torch.no_grad():
        features = network.encoder(torch.randn(1, 3, 32, 64))
        levels = decoder_levels(network.decoder, features)
        torch.testing.assert_close(levels[-1], network.decoder(features))
    shapes = [tuple(level.shape[1:]) for level in levels[-3:]]
    assert shapes == [(64, 8, 16), (32, 16, 32), (16, 32, 64)]


def test_projected_features_are_added_to_the_geometric_pyramid(network):
    pyramid, images = UNetPyramid(FeaturePyramid(), network).eval(), torch.rand(1, 3, 32, 64)
    with torch.no_grad():
        geometry = pyramid.geometry(images)
        semantic = decoder_levels(network.decoder, network.encoder(normalize(images)))[-3:]
        for level, base, added, project in zip(
            pyramid(images), geometry, semantic, pyramid.projections, strict=True
        ):
            torch.testing.assert_close(level, base + project(added))
            assert not torch.equal(level, base)


def test_only_projections_are_added_to_the_u_net_without_its_head(network):
    pyramid = UNetPyramid(FeaturePyramid(), network)
    assert sum(p.numel() for p in pyramid.projections.parameters()) == 2_688
    parts = (pyramid.encoder, pyramid.decoder)
    assert sum(p.numel() for part in parts for p in part.parameters()) == 24_436_224


def test_a_missing_library_is_named_with_its_install_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "segmentation_models_pytorch", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'mvsam\[baselines\]'"):
        unet("resnet34", 20)
