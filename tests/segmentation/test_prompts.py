import numpy as np
import pytest
import torch
from segment_anything.modeling.prompt_encoder import PositionEmbeddingRandom, PromptEncoder

from mvsam.segmentation.prompts import (
    DepthPrompt,
    PositionEncoding,
    centred_depth,
    centred_disparity,
    fill_cells,
)

RANGE = torch.tensor([[0.1, 5.0]])


@pytest.mark.parametrize("size", [(4, 4), (6, 10)])
def test_position_encoding_equals_sam_s_at_cell_centres(size):
    ours, original = PositionEncoding(32), PositionEmbeddingRandom(16)
    ours.load_state_dict({"gaussian": original.positional_encoding_gaussian_matrix})
    torch.testing.assert_close(ours(*size), original(size), atol=1e-5, rtol=0)


def test_position_encoding_keeps_its_precision_under_autocast():
    encoding = PositionEncoding(32)
    expected = encoding(4, 4)
    with torch.autocast("cpu", torch.bfloat16):
        torch.testing.assert_close(encoding(4, 4), expected, atol=1e-5, rtol=0)


def test_position_matrix_is_saved_but_does_not_learn():
    encoding = PositionEncoding(8)
    assert "gaussian" in encoding.state_dict() and not list(encoding.parameters())


def test_depth_prompt_has_the_parameters_of_sam_s_mask_path():
    assert sum(p.numel() for p in DepthPrompt().parameters()) == 4_684


def test_depth_prompt_equals_sam_s_mask_convolutions_on_depth_in_minus_1_to_1():
    original = PromptEncoder(32, (4, 4), (64, 64), mask_in_chans=16)
    prompt = DepthPrompt(32)
    prompt.layers.load_state_dict(original.mask_downscaling.state_dict())
    depth = 0.1 + 4.9 * torch.rand(2, 16, 24)
    embedding, has_depth = prompt(depth, RANGE.expand(2, 2))
    scaled = 2 * (depth - 0.1) / 4.9 - 1
    torch.testing.assert_close(embedding, original._embed_masks(scaled[:, None]))
    assert embedding.shape == (2, 32, 4, 6) and has_depth.all()


def test_depth_beyond_the_range_counts_as_its_end():
    prompt = DepthPrompt(8)
    far, _ = prompt(torch.full((1, 8, 8), 50.0), RANGE)
    end, _ = prompt(torch.full((1, 8, 8), 5.0), RANGE)
    assert torch.equal(far, end)


def test_each_item_is_scaled_by_its_own_range():
    prompt = DepthPrompt(8)
    depth = torch.stack([torch.full((8, 8), 1.0), torch.full((8, 8), 2.0)])
    embedding, _ = prompt(depth, torch.tensor([[0.5, 2.5], [1.0, 5.0]]))
    torch.testing.assert_close(embedding[0], embedding[1])


def test_unknown_pixels_take_the_mean_of_their_cell():
    depth = torch.rand(1, 1, 8, 12) + 0.5
    depth[torch.rand(depth.shape) < 0.4] = 0.0
    depth[:, :, :4, 4:8] = 0.0
    filled, has_depth = fill_cells(depth)
    for row, column in np.ndindex(2, 3):
        cell = depth[0, 0, 4 * row : 4 * row + 4, 4 * column : 4 * column + 4]
        actual = filled[0, 0, 4 * row : 4 * row + 4, 4 * column : 4 * column + 4]
        known = cell[cell > 0]
        assert bool(has_depth[0, 0, row, column]) == (len(known) > 0)
        expected = torch.where(cell > 0, cell, known.mean() if len(known) else cell)
        torch.testing.assert_close(actual, expected)


def test_gradient_of_the_prompt_reaches_the_depth():
    depth = (1 + torch.rand(1, 8, 8)).requires_grad_()
    DepthPrompt(8)(depth, RANGE)[0].square().sum().backward()
    assert depth.grad is not None and depth.grad.abs().sum() > 0


def test_scales_of_the_depth_prompt_reach_from_one_end_of_the_range_to_the_other():
    near, far = torch.tensor(0.5), torch.tensor(4.0)
    depth = torch.tensor([0.0, 0.5, 1.0, 2.25, 4.0, 9.0])
    # 1 m: 2 * 0.5 / 3.5 - 1; as disparity 2 * (1 - 0.25) / (2 - 0.25) - 1.
    linear = torch.tensor([-1.0, -1.0, -5 / 7, 0.0, 1.0, 1.0])
    torch.testing.assert_close(centred_depth(depth, near, far), linear)
    disparity = centred_disparity(depth, near, far)
    torch.testing.assert_close(disparity[[0, 1, 2, 4, 5]], torch.tensor([1, 1, -1 / 7, -1, -1]))


def test_unknown_depth_has_a_finite_gradient_in_every_scale():
    depth = torch.zeros(1, 8, 8, requires_grad=True)
    for scale in (centred_depth, centred_disparity):
        prompt = DepthPrompt(8, scale)
        prompt(depth, torch.tensor([[0.1, 5.0]]))[0].sum().backward()
    assert depth.grad is not None and depth.grad.isfinite().all()


def test_the_prompt_sees_depth_in_the_scale_it_was_given():
    depth, depth_range = torch.rand(1, 8, 8) + 1, torch.tensor([[0.1, 5.0]])
    torch.manual_seed(0)
    linear = DepthPrompt(8)
    inverse = DepthPrompt(8, centred_disparity)
    inverse.load_state_dict(linear.state_dict())
    near, far = depth_range[:, :1, None], depth_range[:, 1:, None]
    # The linear prompt sees in this depth what the other sees in the first.
    same = (centred_disparity(depth, near, far) + 1) / 2 * (far - near) + near
    torch.testing.assert_close(
        linear(same, depth_range)[0], inverse(depth, depth_range)[0], atol=1e-5, rtol=1e-5
    )
