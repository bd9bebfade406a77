import torch

from mvsam.grid_filter import GridFilter


def test_the_grid_of_two_transposed_convolutions_is_taken_out_and_nothing_else_of_flat_maps():
    flat = torch.rand(1, 3, 1, 1).expand(1, 3, 24, 32)
    grid = torch.randn(1, 3, 4, 4).repeat(1, 1, 6, 8)
    inside = (..., slice(2, -2), slice(2, -2))
    smooth = GridFilter()
    torch.testing.assert_close(smooth(flat), flat)
    mean = grid[..., :4, :4].mean(dim=(2, 3), keepdim=True).expand_as(grid)
    torch.testing.assert_close(smooth(grid)[inside], mean[inside])
    assert not smooth.state_dict()
