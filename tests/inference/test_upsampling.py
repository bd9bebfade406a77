import numpy as np
import torch

from mvsam.inference.upsampling import depth_at_size, labels_at_size, smooth_at_size


def values(depth: torch.Tensor) -> set[float]:
    """The different depths, to a hundredth of a millimetre: float32 weights do not sum to one."""
    return {round(value, 5) for value in depth.unique().tolist()}


def test_a_plane_in_depth_stays_a_plane_away_from_the_border():
    columns = (torch.arange(32) + 0.5) / 32  # of the width covered
    depth = (2 + 0.4 * columns).repeat(24, 1)
    wanted = 2 + 0.4 * (torch.arange(80) + 0.5) / 80
    got = depth_at_size(depth, (80, 60))
    # Within half a network pixel of the border there is nothing to interpolate with.
    torch.testing.assert_close(got[30, 2:-2], wanted[2:-2])


def test_no_depth_between_two_surfaces_is_invented():
    depth = torch.full((6, 8), 1.0)
    depth[:, 4:] = 3.0
    got = depth_at_size(depth, (37, 29))
    assert values(got) == {1.0, 3.0}
    assert len(values(smooth_at_size(depth, (37, 29)))) > 2  # bilinear alone does invent some


def test_unknown_depth_does_not_leak_into_its_neighbours():
    depth = torch.full((6, 8), 2.0)
    depth[2, 3] = 0.0
    assert values(depth_at_size(depth, (40, 30))) == {0.0, 2.0}


def test_the_edge_stays_where_it_was_in_the_picture():
    depth = torch.full((4, 8), 1.0)
    depth[:, 2:] = 3.0
    got = depth_at_size(depth, (80, 40))
    assert values(got[:, :20]) == {1.0} and values(got[:, 20:]) == {3.0}


def test_labels_are_the_argmax_of_bilinear_logits():
    logits = torch.randn(5, 6, 8, generator=torch.Generator().manual_seed(0))
    whole = torch.nn.functional.interpolate(
        logits[None], size=(30, 44), mode="bilinear", align_corners=False
    )[0]
    got = labels_at_size(logits, (44, 30))
    assert got.dtype == torch.uint8
    np.testing.assert_array_equal(got, whole.argmax(0))


def test_maps_of_the_right_size_come_back_untouched():
    depth = torch.rand(6, 8) + 1
    torch.testing.assert_close(depth_at_size(depth, (8, 6)), depth, rtol=0, atol=0)
