import torch

from mvsam.encoders.fusion import SemanticPyramid


def test_parameters_for_sam_s_256_channels_are_as_specified():
    assert sum(p.numel() for p in SemanticPyramid(256).parameters()) == 100_288


def test_levels_have_one_two_and_four_times_the_size_of_the_features():
    levels = SemanticPyramid(12, width=4).eval()(torch.rand(2, 12, 8, 10))
    assert [level.shape[1:] for level in levels] == [(32, 8, 10), (16, 16, 20), (8, 32, 40)]


def test_levels_take_both_signs():
    for level in SemanticPyramid(12).eval()(torch.rand(1, 12, 8, 8)):
        assert level.min() < 0 < level.max()
