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


def _weight_of_the_top_down_path(pyramid: FeaturePyramid) -> None:
    """Levels then show what comes from above alone, one channel of it as it is."""
    for name in ("lateral_half.weight", "lateral_half.bias", "lateral_full.weight"):
        torch.nn.init.zeros_(pyramid.get_parameter(name))
    torch.nn.init.zeros_(pyramid.get_parameter("lateral_full.bias"))
    torch.nn.init.dirac_(pyramid.get_parameter("out_full.weight"))


def test_bilinear_upsampling_makes_no_blocks_of_the_coarse_features():
    torch.manual_seed(0)
    images = torch.rand(1, 3, 32, 32)
    blocks = FeaturePyramid().eval()
    _weight_of_the_top_down_path(blocks)
    smooth = FeaturePyramid(upsampling="bilinear").eval()
    smooth.load_state_dict(blocks.state_dict())
    for pyramid, has_blocks in ((blocks, True), (smooth, False)):
        full = pyramid(images)[2]
        is_constant = full.unflatten(-1, (-1, 4)).diff(dim=-1).abs().max() == 0
        assert bool(is_constant) == has_blocks
    assert torch.equal(blocks(images)[0], smooth(images)[0])
