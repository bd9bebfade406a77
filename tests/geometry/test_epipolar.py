"""Cameras around a cloud of points, given with errors: the matches bring most of them back."""

import math

import numpy as np
import pytest
import torch

from mvsam.geometry import epipolar
from mvsam.geometry.epipolar import Matches, epipolar_distances, fit_poses
from mvsam.geometry.pose import invert, moved_by

PIXEL = 1 / 500


def cameras(count: int = 5) -> torch.Tensor:
    """Side by side, 20 cm apart, looking along z with a few degrees between them."""
    poses = torch.eye(4, dtype=torch.float64).repeat(count, 1, 1)
    steps = torch.zeros(count, 6, dtype=torch.float64)
    steps[:, 1] = torch.linspace(-0.2, 0.2, count, dtype=torch.float64)
    steps[:, 3] = 0.2 * torch.arange(count)
    steps[:, 4] = 0.05 * torch.arange(count) % 0.1
    return moved_by(poses, steps)


def matches_of(poses: torch.Tensor, dice: torch.Generator, pixels: float = 0.0) -> list[Matches]:
    points = torch.rand(60, 3, generator=dice, dtype=torch.float64) * 2 + torch.tensor(
        [-0.6, -1, 1.5]
    )
    seen = points @ invert(poses)[:, :3, :3].mT + invert(poses)[:, None, :3, 3]
    rays = seen / seen[..., 2:]
    rays[..., :2] += pixels * PIXEL * torch.randn(rays[..., :2].shape, generator=dice)
    pairs = [(i, j) for i in range(len(poses)) for j in range(i + 1, len(poses))]
    return [Matches(i, j, rays[i], rays[j]) for i, j in pairs]


def displaced(poses: torch.Tensor, dice: torch.Generator) -> torch.Tensor:
    """By about half a degree and a centimetre."""
    spread = torch.tensor([math.radians(0.3)] * 3 + [0.008] * 3, dtype=torch.float64)
    return moved_by(poses, spread * torch.randn(len(poses), 6, generator=dice, dtype=torch.float64))


def test_exact_poses_stay_and_their_matches_lie_on_the_lines():
    poses = cameras()
    pairs = matches_of(poses, torch.Generator().manual_seed(0))
    assert torch.cat(epipolar_distances(poses, pairs)).max() < 1e-12
    torch.testing.assert_close(fit_poses(poses, pairs, PIXEL), poses, atol=1e-9, rtol=0)


@pytest.mark.parametrize("seed", range(3))
def test_displaced_cameras_come_back_to_the_lines(seed: int):
    dice = torch.Generator().manual_seed(seed)
    poses = cameras()
    pairs = matches_of(poses, dice, pixels=0.3)
    given = displaced(poses, dice)
    found = fit_poses(given, pairs, PIXEL)
    before, after = (
        torch.cat(epipolar_distances(p, pairs)).median() / PIXEL for p in (given, found)
    )
    assert before > 1 and after < 0.3

    def errors(candidate: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Of each camera seen from the first: degrees, and how far its distance is off, a share."""
        relative, true = invert(candidate[:1]) @ candidate, invert(poses[:1]) @ poses
        turns = (relative[1:, :3, :3] * true[1:, :3, :3]).sum(dim=(1, 2))
        lengths = relative[1:, :3, 3].norm(dim=1) / true[1:, :3, 3].norm(dim=1)
        return ((turns - 1) / 2).clamp(max=1).acos().rad2deg(), (lengths - 1).abs()

    assert errors(found)[0].mean() < 0.6 * errors(given)[0].mean()
    assert errors(found)[1].mean() < 0.1, "no match tells the distance; it must not drift"
    rotations = found[:, :3, :3]
    torch.testing.assert_close(
        rotations @ rotations.mT, torch.eye(3, dtype=torch.float64).expand_as(rotations)
    )


def test_wrong_matches_hardly_count():
    dice = torch.Generator().manual_seed(1)
    poses = cameras()
    right = matches_of(poses, dice)
    given = displaced(poses, dice)
    wrong = [
        Matches(
            pair.first,
            pair.second,
            pair.first_rays,
            torch.cat([pair.second_rays[:45], pair.second_rays[45:].flip(0)]),
        )
        for pair in right
    ]
    found = fit_poses(given, wrong, PIXEL)
    assert torch.cat(epipolar_distances(found, right)).median() < 0.2 * PIXEL
    assert torch.cat(epipolar_distances(given, right)).median() > PIXEL


def test_a_camera_without_matches_stays():
    dice = torch.Generator().manual_seed(2)
    poses = cameras()
    pairs = [pair for pair in matches_of(poses, dice) if pair.second != 4]
    given = displaced(poses, dice)
    found = fit_poses(given, pairs, PIXEL)
    torch.testing.assert_close(found[4], given[4], atol=1e-12, rtol=0)
    assert not torch.allclose(found[:4], given[:4], atol=1e-4)
    assert torch.equal(fit_poses(given, [], PIXEL), given)


def test_pairs_may_have_different_numbers_of_matches():
    dice = torch.Generator().manual_seed(3)
    poses = cameras(3)
    pairs = matches_of(poses, dice)
    few = Matches(0, 1, pairs[0].first_rays[:20], pairs[0].second_rays[:20])
    given = displaced(poses, dice)
    assert list(map(len, epipolar_distances(given, [few, *pairs[1:]]))) == [20, 60, 60]
    found = fit_poses(given, [few, *pairs[1:]], PIXEL)
    assert torch.cat(epipolar_distances(found, pairs)).median() < 0.2 * PIXEL


@pytest.mark.parametrize("metres", (0.02, 0.2))
def test_derivatives_against_differences(metres: float):
    dice = torch.Generator().manual_seed(4)
    poses = cameras(2)
    poses[1, :3, 3] *= metres / poses[1, :3, 3].norm()
    given = displaced(poses, dice)
    padded = epipolar._Padded.of(matches_of(poses, dice, pixels=2.0))
    relative = epipolar._relative(given, padded)
    motion = epipolar._relative_motion(relative)
    distances, jacobian = epipolar._residuals(relative, padded)
    changes, change_jacobian = epipolar._changes(relative, relative)
    assert distances.abs().max() > PIXEL, "else what divides them would not matter"
    for unknown in range(12):
        step = torch.zeros(2, 6, dtype=torch.float64)
        step.view(-1)[unknown] = 1e-7
        after = epipolar._relative(moved_by(given, step), padded)
        found, _ = epipolar._residuals(after, padded)
        expected = jacobian @ motion[:, :, unknown, None]
        torch.testing.assert_close(
            (found - distances) / 1e-7, expected[..., 0], atol=1e-4, rtol=1e-4
        )
        changed, _ = epipolar._changes(after, relative)
        expected = change_jacobian @ motion[:, :, unknown, None]
        torch.testing.assert_close(
            (changed - changes) / 1e-7, expected[..., 0], atol=1e-3, rtol=1e-4
        )


def test_distances_are_those_of_the_definition():
    """In NumPy, match by match; and of one that is 0.01 beside the line in one picture."""
    poses = cameras(2)
    (pair,) = matches_of(poses, torch.Generator().manual_seed(5), pixels=1.0)
    (found,) = epipolar_distances(poses, [pair])
    relative = np.linalg.inv(poses[1].numpy()) @ poses[0].numpy()
    x, y, z = relative[:3, 3]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ relative[:3, :3]
    for distance, first, second in zip(found, pair.first_rays, pair.second_rays, strict=True):
        here, there = essential.T @ second.numpy(), essential @ first.numpy()
        divisor = np.sqrt(here[0] ** 2 + here[1] ** 2 + there[0] ** 2 + there[1] ** 2)
        assert float(distance) == pytest.approx(abs(second.numpy() @ there) / divisor)

    sideways = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
    sideways[1, 0, 3] = 0.1
    ray = torch.tensor([[0.1, 0.2, 1.0]], dtype=torch.float64)
    (off,) = epipolar_distances(
        sideways, [Matches(0, 1, ray, ray + torch.tensor([-0.05, 0.01, 0]))]
    )
    assert float(off) == pytest.approx(0.01 / math.sqrt(2))


def test_short_baselines_do_not_turn_away():
    """Two centimetres apart, by which the given poses are off too."""
    better = 0
    for seed in range(8):
        dice = torch.Generator().manual_seed(seed)
        poses = cameras(5)
        poses[:, :3, 3] *= 0.1
        given = displaced(poses, dice)
        found = fit_poses(given, matches_of(poses, dice, pixels=0.3), PIXEL)
        better += int(direction_errors(found, poses) < direction_errors(given, poses))
    assert better >= 7


def direction_errors(candidate: torch.Tensor, poses: torch.Tensor) -> float:
    """Degrees, mean over the directions in which the first camera sees the others."""
    ways = [(invert(p[:1]) @ p)[1:, :3, 3] for p in (candidate, poses)]
    cosines = torch.nn.functional.cosine_similarity(*ways, dim=1)
    return cosines.clamp(max=1).acos().rad2deg().mean().item()


def test_views_at_one_place_have_no_lines():
    poses = torch.eye(4).repeat(2, 1, 1)
    ray = torch.tensor([[0.0, 0.0, 1.0]])
    for ask in (
        lambda pairs: fit_poses(poses, pairs, PIXEL),
        lambda pairs: epipolar_distances(poses, pairs),
    ):
        with pytest.raises(ValueError, match="at one place"):
            ask([Matches(0, 1, ray, ray)])
