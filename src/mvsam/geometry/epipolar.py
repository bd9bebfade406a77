"""Poses that are moved so that matched points of two pictures lie on each other's epipolar lines.

A plane sweep looks for a pixel's partner along its epipolar line. Where poses are off by half a
degree the line misses it by several pixels, and at no depth do the pictures match.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.linalg import cross
from torch.nn.utils.rnn import pad_sequence

from mvsam.geometry.pose import cross_matrix, invert, moved_by

MATCHES_WORTH = 30
"""More matches of a pair count as much as these: what an imperfect lens does to all of them is no
noise that more of them would average out."""
PAIR_DEGREES, PAIR_METRES = 1.0, 0.03
"""Standard deviations of the error of one given pose relative to another's."""
WORLD_DEGREES, WORLD_METRES = 5.0, 0.2
"""Of a given pose in the world, which drifts."""
STEPS = 15


@dataclass(frozen=True)
class Matches:
    """Where two views, `first` and `second` by number, show the same points."""

    first: int
    second: int
    first_rays: Float[Tensor, "match 3"]
    """In the first camera's axes, at z = 1."""
    second_rays: Float[Tensor, "match 3"]


def fit_poses(
    world_from_cam: Float[Tensor, "view 4 4"], pairs: Sequence[Matches], spread: float
) -> Float[Tensor, "view 4 4"]:
    """The poses, moved as little as the matches ask for; those of views without matches stay.

    Least squares by Gauss-Newton: epipolar distances with Cauchy's loss, so that wrong matches
    hardly count, and the changes of each pair's relative pose and of each pose, as Gaussian. The
    distance of two cameras, which no match tells, so stays the given one, on the whole.
    spread: of a right match's distance, at z = 1 (pixels over the focal length).
    """
    given = world_from_cam.double()
    if not pairs:
        return given
    matches = _Padded.of(pairs)
    before = _second_from_first(given, matches)
    poses, offsets = given, given.new_zeros(len(given), 6)
    for _ in range(STEPS):
        now = _second_from_first(poses, matches)
        distances, slopes = _distances(now, matches)
        distances, slopes = distances / spread, slopes / spread
        weights = matches.shares / (1 + distances**2)
        changes, change_slopes = _changes(now, before)
        weighted = slopes.mT * weights[:, None]
        curvature = weighted @ slopes + change_slopes.mT @ change_slopes
        gradient = weighted @ distances[..., None] + change_slopes.mT @ changes[..., None]
        step = _solved(curvature, gradient[..., 0], matches, offsets)
        poses, offsets = moved_by(poses, step), offsets + step
    return poses


def epipolar_distances(
    world_from_cam: Float[Tensor, "view 4 4"], pairs: Sequence[Matches]
) -> Float[Tensor, "all_matches"]:
    """Sampson's distance of every match from its epipolar lines, at z = 1."""
    matches = _Padded.of(pairs)
    distances, _ = _distances(_second_from_first(world_from_cam.double(), matches), matches)
    return distances[matches.shares > 0].abs()


@dataclass(frozen=True)
class _Padded:
    """The matches of all pairs."""

    first: Int[Tensor, "pair"]
    second: Int[Tensor, "pair"]
    first_rays: Float[Tensor, "pair match 3"]
    second_rays: Float[Tensor, "pair match 3"]
    shares: Float[Tensor, "pair match"]
    """What each counts; 0 behind a pair's last."""

    @staticmethod
    def of(pairs: Sequence[Matches]) -> "_Padded":
        lengths = torch.tensor([len(pair.first_rays) for pair in pairs])[:, None]
        first_rays = pad_sequence([pair.first_rays.double() for pair in pairs], batch_first=True)
        second_rays = pad_sequence([pair.second_rays.double() for pair in pairs], batch_first=True)
        is_match = torch.arange(first_rays.shape[1]) < lengths
        return _Padded(
            torch.tensor([pair.first for pair in pairs]),
            torch.tensor([pair.second for pair in pairs]),
            first_rays,
            second_rays,
            is_match * (MATCHES_WORTH / lengths.double()).clamp(max=1),
        )


def _second_from_first(
    poses: Float[Tensor, "view 4 4"], matches: _Padded
) -> Float[Tensor, "pair 4 4"]:
    return invert(poses[matches.second]) @ poses[matches.first]


def _distances(
    second_from_first: Float[Tensor, "pair 4 4"], matches: _Padded
) -> tuple[Float[Tensor, "pair match"], Float[Tensor, "pair match 12"]]:
    """(distances with signs, their slopes by the first camera's step and the second's).

    The slopes are those of the triple product of the way's direction, ray and ray; what divides it
    stays. A shorter way is no remedy, so none of them goes along it.
    """
    rotation, way = second_from_first[:, None, :3, :3], second_from_first[:, None, :3, 3]
    length = way.norm(dim=-1, keepdim=True)
    way = way / length
    first, second = matches.first_rays, matches.second_rays
    turned = _times(rotation, first)
    lines = cross(way, turned)  # epipolar lines in the second picture
    first_lines = _times(rotation.mT, cross(second, way.expand_as(second)))
    product = (second * lines).sum(dim=-1)
    steepness = lines[..., :2].square().sum(dim=-1) + first_lines[..., :2].square().sum(dim=-1)
    by_way = cross(turned, second)
    by_way = (by_way - (by_way * way).sum(dim=-1, keepdim=True) * way) / length
    slopes = [cross(first, first_lines), _times(rotation.mT, by_way), cross(second, lines), -by_way]
    scale = steepness.clamp(min=1e-12).rsqrt()
    return product * scale, torch.cat(slopes, dim=-1) * scale[..., None]


def _changes(
    now: Float[Tensor, "pair 4 4"], before: Float[Tensor, "pair 4 4"]
) -> tuple[Float[Tensor, "pair 6"], Float[Tensor, "pair 6 12"]]:
    """(turn and way of the second camera seen from the first, since before; their slopes).

    In standard deviations, to first order in the turn.
    """
    rotation, way = now[:, :3, :3], now[:, :3, 3]
    turn = rotation @ before[:, :3, :3].mT
    axis_angle = torch.stack(
        [
            turn[:, 2, 1] - turn[:, 1, 2],
            turn[:, 0, 2] - turn[:, 2, 0],
            turn[:, 1, 0] - turn[:, 0, 1],
        ],
        dim=1,
    )
    slopes = now.new_zeros(len(now), 6, 12)
    slopes[:, :3, :3] = slopes[:, 3:, 3:6] = rotation
    slopes[:, :3, 6:9] = slopes[:, 3:, 9:] = -torch.eye(3, dtype=now.dtype)
    slopes[:, 3:, 6:9] = cross_matrix(way)
    deviations = now.new_tensor([_radians(PAIR_DEGREES)] * 3 + [PAIR_METRES] * 3)
    changes = torch.cat([axis_angle / 2, way - before[:, :3, 3]], dim=1)
    return changes / deviations, slopes / deviations[:, None]


def _times(
    matrix: Float[Tensor, "pair 1 3 3"], vectors: Float[Tensor, "pair match 3"]
) -> Float[Tensor, "pair match 3"]:
    return (matrix @ vectors[..., None])[..., 0]


def _solved(
    curvature: Float[Tensor, "pair 12 12"],
    gradient: Float[Tensor, "pair 12"],
    matches: _Padded,
    offsets: Float[Tensor, "view 6"],
) -> Float[Tensor, "view 6"]:
    """Each camera's step, from what the pairs say and how far it is from where it began."""
    numbers = torch.arange(offsets.numel()).reshape(-1, 6)
    unknowns = torch.cat([numbers[matches.first], numbers[matches.second]], dim=1)
    places = (unknowns[:, :, None].expand_as(curvature), unknowns[:, None].expand_as(curvature))
    full = curvature.new_zeros(offsets.numel(), offsets.numel())
    full.index_put_(places, curvature, accumulate=True)
    right = gradient.new_zeros(offsets.numel()).index_put_((unknowns,), gradient, accumulate=True)
    deviations = offsets.new_tensor([_radians(WORLD_DEGREES)] * 3 + [WORLD_METRES] * 3)
    hold = (deviations**-2).expand_as(offsets)
    full += torch.diag(hold.flatten())
    right += (hold * offsets).flatten()
    return -torch.linalg.solve(full, right).reshape(offsets.shape)


def _radians(degrees: float) -> float:
    return degrees * torch.pi / 180
