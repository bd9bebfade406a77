import torch

from mvsam.encoders.fpn import FeaturePyramid


def test_parameters_are_those_of_cas_mvsnet():
    assert sum(p.numel() for p in FeaturePyramid().parameters()) == 48_920


def test_levels_are_a_quarter_half_and_full_size_with_32_16_and_8_channels():
    levels = FeaturePyramid().eval()(torch.rand(2, 3, 32, 64))
    assert [level.shape[1:] for level in levels] == [(32, 8, 16), (16, 16, 32), (8, 32, 64)]


def test_levels_take_both_signs():
    for level in FeaturePyramid().eval()(torch.rand(1, 3, 32, 32)):
        assert level.min() < 0 < level.max()
