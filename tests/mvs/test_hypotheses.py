import pytest
import torch
import torch.nn.functional as F

from mvsam.mvs.hypotheses import base_interval, plane_depths, resample_depth, window_hypotheses

PAPER_RANGE = torch.tensor([[0.1, 5.0]], dtype=torch.float64)


def test_base_interval_is_the_range_over_192():
    assert base_interval(PAPER_RANGE).item() == pytest.approx(0.0255208333, abs=1e-10)


def test_both_ends_are_exact_in_single_precision():
    torch.manual_seed(0)
    near = torch.rand(1000, 1) + 0.05
    ranges = torch.cat([near, near + 5 * torch.rand(1000, 1) + 0.1], dim=1)
    planes = plane_depths(ranges, 48)
    assert torch.equal(planes[:, 0], ranges[:, 0]) and torch.equal(planes[:, -1], ranges[:, 1])


def test_coarse_planes_include_both_ends_of_the_range():
    planes = plane_depths(PAPER_RANGE, 48)[0]
    assert planes[0].item() == 0.1 and planes[-1].item() == pytest.approx(5.0, abs=1e-12)
    spacing = planes.diff()
    assert spacing.min().item() == pytest.approx(0.1042553191, abs=1e-10)
    assert spacing.max().item() == pytest.approx(0.1042553191, abs=1e-10)


def test_planes_follow_each_item_s_own_range():
    planes = plane_depths(torch.tensor([[0.1, 5.0], [1.0, 2.0]]), 3)
    torch.testing.assert_close(planes, torch.tensor([[0.1, 2.55, 5.0], [1.0, 1.5, 2.0]]))


@pytest.mark.parametrize(
    "num_planes, ratio, width, spacing",
    [(32, 1.0, 0.8166666667, 0.0263440860), (8, 0.5, 0.1020833333, 0.0145833333)],
)
def test_refined_windows_have_the_paper_s_width_and_spacing(num_planes, ratio, width, spacing):
    half_width = base_interval(PAPER_RANGE) * num_planes * ratio / 2
    centre = torch.full((1, 1, 1), 2.0, dtype=torch.float64)
    window = window_hypotheses(centre, half_width, num_planes, None)[0, :, 0, 0]
    assert (window[-1] - window[0]).item() == pytest.approx(width, abs=1e-10)
    assert window.diff().mean().item() == pytest.approx(spacing, abs=1e-10)
    assert window.mean().item() == pytest.approx(2.0, abs=1e-12)


def test_shift_moves_a_near_window_to_begin_at_the_nearest_depth():
    centre = torch.tensor([[[0.2, 3.0]]])
    half_width, nearest = torch.tensor([0.4]), torch.tensor([0.1])
    free = window_hypotheses(centre, half_width, 5, None)
    shifted = window_hypotheses(centre, half_width, 5, nearest)
    torch.testing.assert_close(free[0, :, 0, 0], torch.tensor([-0.2, 0.0, 0.2, 0.4, 0.6]))
    torch.testing.assert_close(shifted[0, :, 0, 0], torch.tensor([0.1, 0.3, 0.5, 0.7, 0.9]))
    assert torch.equal(shifted[..., 1], free[..., 1])


def test_shift_does_not_clamp_at_the_far_end():
    window = window_hypotheses(
        torch.full((1, 1, 1), 5.0), torch.tensor([0.4]), 3, torch.tensor([0.1])
    )
    torch.testing.assert_close(window.flatten(), torch.tensor([4.6, 5.0, 5.4]))


@pytest.mark.parametrize("size", [(16, 24), (32, 48)])
def test_hypotheses_equal_those_made_at_full_size_and_reduced(size):
    # CasMVSNet makes the planes of every stage at the photo's size and reduces them trilinearly.
    previous = 0.5 + 4 * torch.rand(2, 8, 12, dtype=torch.float64)
    half_width = torch.tensor([0.4, 0.3], dtype=torch.float64)
    full = F.interpolate(previous[:, None], (32, 48), mode="bilinear", align_corners=False)[:, 0]
    at_full_size = window_hypotheses(full, half_width, 8, None)
    expected = F.interpolate(
        at_full_size[:, None], (8, *size), mode="trilinear", align_corners=False
    )[:, 0]
    centre = resample_depth(previous, (32, 48), size)
    torch.testing.assert_close(window_hypotheses(centre, half_width, 8, None), expected)
