"""Poses moved so that matched points of two pictures lie on each other's epipolar lines.

A plane sweep looks for a pixel's partner along its epipolar line. Where poses are off by half a
degree the line misses it by several pixels, and at no depth do the pictures match.

Distances from the lines are Sampson's (Hartley and Zisserman, Multiple View Geometry, 11.4.3); a
change of the given relative poses costs as in a pose graph.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.linalg import cross
from torch.nn.utils.rnn import pad_sequence

from mvsam.geometry.pose import cross_matrix, invert, moved_by

MATCHES_WORTH = 30
"""More matches of a pair count as much as these: what an imperfect lens does to all of them is no
noise that more of them would average out."""
RELATIVE_DEGREES, RELATIVE_METRES = 1.0, 0.03
"""Standard deviations of the error of one given pose relative to another's."""
WORLD_DEGREES, WORLD_METRES = 5.0, 0.2
"""Of a given pose in the world, which drifts."""
MOST_STEPS = 50
MOST_HALVINGS = 8
ENOUGH = 1e-6
"""Share of the cost; a step that lowers it by less is the last."""


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
    """The poses, float64, moved as little as the matches ask for; translations are metres.

    Damped Gauss-Newton on the sum of three: the matches' distances from their epipolar lines, with
    Cauchy's loss, so that wrong matches hardly count; the changes of each pair's relative pose; and
    of each pose. So the distance of two cameras, which no match tells, stays the given one on the
    whole, and a view without matches stays where it is.
    spread: of a right match's distance, at z = 1 (pixels over the focal length).
    Raises ValueError where both views of a pair stand at one place.
    """
    poses = world_from_cam.double()
    if not pairs:
        return poses
    problem = _Problem(poses, _Padded.of(pairs), spread)
    offsets = poses.new_zeros(len(poses), 6)
    cost = problem.cost(poses, offsets)
    for _ in range(MOST_STEPS):
        step, before = problem.step(poses, offsets), cost
        for _ in range(MOST_HALVINGS):
            cost = problem.cost(moved_by(poses, step), offsets + step)
            if cost < before:
                break
            step = step / 2
        else:
            break
        poses, offsets = moved_by(poses, step), offsets + step
        if before - cost < ENOUGH * before:
            break
    return poses


def epipolar_distances(
    world_from_cam: Float[Tensor, "view 4 4"], pairs: Sequence[Matches]
) -> list[Float[Tensor, "_match"]]:
    """Sampson's distance of every pair's matches from their epipolar lines, at z = 1.

    A match beside its line by d in one of two like pictures has 0.7 d. Raises as `fit_poses`.
    """
    matches = _Padded.of(pairs)
    distances, _ = _residuals(_relative(world_from_cam.double(), matches), matches)
    return [row[: len(pair.first_rays)].abs() for row, pair in zip(distances, pairs, strict=True)]


@dataclass(frozen=True)
class _Padded:
    """The matches of all pairs."""

    first: Int[Tensor, "pair"]
    second: Int[Tensor, "pair"]
    first_rays: Float[Tensor, "pair match 3"]
    second_rays: Float[Tensor, "pair match 3"]
    weights: Float[Tensor, "pair match"]
    """0 behind a pair's last match."""

    @staticmethod
    def of(pairs: Sequence[Matches]) -> "_Padded":
        lengths = torch.tensor([len(pair.first_rays) for pair in pairs])[:, None]
        first_rays, second_rays = (
            pad_sequence([r.double() for r in rays], batch_first=True, padding_value=1.0)
            for rays in ([p.first_rays for p in pairs], [p.second_rays for p in pairs])
        )
        is_match = torch.arange(first_rays.shape[1]) < lengths
        return _Padded(
            torch.tensor([pair.first for pair in pairs]),
            torch.tensor([pair.second for pair in pairs]),
            first_rays,
            second_rays,
            is_match * (MATCHES_WORTH / lengths.double()).clamp(max=1),
        )


@dataclass(frozen=True)
class _Problem:
    """What is minimised."""

    given: Float[Tensor, "view 4 4"]
    matches: _Padded
    spread: float

    @cached_property
    def _relative_given(self) -> Float[Tensor, "pair 4 4"]:
        return _relative(self.given, self.matches)

    def cost(
        self, poses: Float[Tensor, "view 4 4"], offsets: Float[Tensor, "view 6"]
    ) -> Float[Tensor, ""]:
        """offsets: of the poses from the given ones, as `moved_by` takes them."""
        relative = _relative(poses, self.matches)
        distances, _ = _residuals(relative, self.matches)
        changes, _ = _changes(relative, self._relative_given)
        of_matches = self.matches.weights * (distances / self.spread).square().log1p()
        of_offsets = _world_precision(offsets) * offsets.square()
        return (of_matches.sum() + changes.square().sum() + of_offsets.sum()) / 2

    def step(
        self, poses: Float[Tensor, "view 4 4"], offsets: Float[Tensor, "view 6"]
    ) -> Float[Tensor, "view 6"]:
        """That of Gauss and Newton, of every camera in its own axes."""
        relative = _relative(poses, self.matches)
        distances, jacobian = _residuals(relative, self.matches)
        distances, jacobian = distances / self.spread, jacobian / self.spread
        changes, change_jacobian = _changes(relative, self._relative_given)
        weighted = jacobian.mT * (self.matches.weights / (1 + distances**2))[:, None]
        normal = weighted @ jacobian + change_jacobian.mT @ change_jacobian
        gradient = weighted @ distances[..., None] + change_jacobian.mT @ changes[..., None]
        by_cameras = _relative_motion(relative)
        normal, gradient = by_cameras.mT @ normal @ by_cameras, by_cameras.mT @ gradient
        return self._solved(normal, gradient[..., 0], offsets)

    def _solved(
        self,
        normal: Float[Tensor, "pair 12 12"],
        gradient: Float[Tensor, "pair 12"],
        offsets: Float[Tensor, "view 6"],
    ) -> Float[Tensor, "view 6"]:
        """Sums up the pairs' normal equations and solves them."""
        numbers = torch.arange(offsets.numel()).reshape(-1, 6)
        unknowns = torch.cat([numbers[self.matches.first], numbers[self.matches.second]], dim=1)
        places = unknowns[:, :, None].expand_as(normal), unknowns[:, None].expand_as(normal)
        precision = _world_precision(offsets).expand_as(offsets).flatten()
        matrix = torch.diag(precision).index_put_(places, normal, accumulate=True)
        right = precision * offsets.flatten()
        right = right.index_put_((unknowns,), gradient, accumulate=True)
        factor = torch.linalg.cholesky(matrix)
        return -torch.cholesky_solve(right[:, None], factor).reshape(offsets.shape)


def _world_precision(offsets: Float[Tensor, "view 6"]) -> Float[Tensor, "6"]:
    return _deviations(offsets, WORLD_DEGREES, WORLD_METRES) ** -2


def _deviations(like: Tensor, degrees: float, metres: float) -> Float[Tensor, "6"]:
    return like.new_tensor([degrees * torch.pi / 180] * 3 + [metres] * 3)


def _relative(poses: Float[Tensor, "view 4 4"], matches: _Padded) -> Float[Tensor, "pair 4 4"]:
    """`second_from_first` of every pair."""
    relative = invert(poses[matches.second]) @ poses[matches.first]
    if not relative[:, :3, 3].any(dim=1).all():
        raise ValueError("two views at one place have no epipolar lines: leave the pair out")
    return relative


def _residuals(
    second_from_first: Float[Tensor, "pair 4 4"], matches: _Padded
) -> tuple[Float[Tensor, "pair match"], Float[Tensor, "pair match 6"]]:
    """(Sampson's distances, with signs; their derivatives by a motion of the second camera's axes).

    The motion is a rotation vector w, then a translation v: `second_from_first` becomes
    (1 + [w]x, v) `second_from_first`.
    """
    rotation = second_from_first[:, None, :3, :3]
    translation = second_from_first[:, None, :3, 3].expand_as(matches.first_rays)
    rays = matches.second_rays
    turned = _times(rotation, matches.first_rays)
    second_lines = cross(translation, turned)
    first_lines = cross(rays, translation)  # in the second camera's axes
    product = (rays * second_lines).sum(dim=-1)
    # The steepness of the product in each picture's plane, which is not along z.
    in_second = second_lines * second_lines.new_tensor([1.0, 1.0, 0.0])
    flat = _times(rotation.mT, first_lines) * first_lines.new_tensor([1.0, 1.0, 0.0])
    in_first = _times(rotation, flat)
    squared = in_second.square().sum(dim=-1) + in_first.square().sum(dim=-1)
    scale = squared.clamp(min=1e-24).rsqrt()
    by_rotation = (
        cross(second_lines, rays),
        cross(second_lines, in_second) + cross(rays, cross(in_first, translation)),
    )
    by_translation = cross(turned, rays), cross(turned, in_second) + cross(in_first, rays)
    numerators = torch.cat([by_rotation[0], by_translation[0]], dim=-1)
    divisors = torch.cat([by_rotation[1], by_translation[1]], dim=-1)
    jacobian = numerators * scale[..., None] - divisors * (product * scale**3)[..., None]
    return product * scale, jacobian


def _changes(
    now: Float[Tensor, "pair 4 4"], given: Float[Tensor, "pair 4 4"]
) -> tuple[Float[Tensor, "pair 6"], Float[Tensor, "pair 6 6"]]:
    """Of the relative poses, in standard deviations, and their derivatives as in `_residuals`.

    Rotations to first order.
    """
    rotation = now[:, :3, :3] @ given[:, :3, :3].mT
    skew = (rotation - rotation.mT) / 2
    rotation_vector = torch.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], dim=1)
    changes = torch.cat([rotation_vector, now[:, :3, 3] - given[:, :3, 3]], dim=1)
    jacobian = torch.eye(6, dtype=now.dtype).repeat(len(now), 1, 1)
    jacobian[:, 3:, :3] = -cross_matrix(now[:, :3, 3])
    deviations = _deviations(now, RELATIVE_DEGREES, RELATIVE_METRES)
    return changes / deviations, jacobian / deviations[:, None]


def _relative_motion(
    second_from_first: Float[Tensor, "pair 4 4"],
) -> Float[Tensor, "pair 6 12"]:
    """The motion of `_residuals` by steps of the first and the second camera in their own axes."""
    rotation, translation = second_from_first[:, :3, :3], second_from_first[:, :3, 3]
    motion = second_from_first.new_zeros(len(second_from_first), 6, 12)
    motion[:, :3, :3] = motion[:, 3:, 3:6] = rotation
    motion[:, 3:, :3] = cross_matrix(translation) @ rotation
    motion[:, :, 6:] = -torch.eye(6, dtype=motion.dtype)
    return motion


def _times(
    matrix: Float[Tensor, "pair 1 3 3"], vectors: Float[Tensor, "pair match 3"]
) -> Float[Tensor, "pair match 3"]:
    return (matrix @ vectors[..., None])[..., 0]
