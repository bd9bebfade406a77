"""How a stage's hypotheses are scored: by all views together, or by each source's vote as well.

One variance over all views takes a view that looks elsewhere, or that stands a little off where it
is said to stand, for a mismatch of them all. So the same network can also score the reference
beside each source alone. That is not in the paper, whose variance (Eq. 2) is one of the opinions;
of our networks `tiny` alone does it, in the first sweep. What it is worth: docs/log.md, 2026-11-29.
"""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

VolumeOf = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
"""`cost_volume.variance_volume`, or its specification."""
Regularizer = Callable[[Tensor], Tensor]
"""Volumes to scores before the softmax over planes."""
Scoring = Callable[[VolumeOf, Regularizer, Tensor, Tensor, Tensor, Tensor], Tensor]
"""`joint_scores` or `voted_scores`."""


def joint_scores(
    volume_of: VolumeOf,
    regularizer: Regularizer,
    features: Float[Tensor, "batch view channel height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    world_from_cam: Float[Tensor, "batch view 4 4"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch plane height width"]:
    """By all views together, as the paper has it."""
    return regularizer(volume_of(features, intrinsics, world_from_cam, hypotheses))


def voted_scores(
    volume_of: VolumeOf,
    regularizer: Regularizer,
    features: Float[Tensor, "batch view channel height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    world_from_cam: Float[Tensor, "batch view 4 4"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch plane height width"]:
    """Mean of the scores by all views and by each source alone.

    After the softmax that is the geometric mean of their probabilities, normalised. Where gradients
    are kept, all volumes are one batch, with one update of batch norms whose statistics are over
    both kinds; in an exported graph too, whose number of views is free. Elsewhere one opinion comes
    after the other, in the memory of one.
    """
    num_sources = features.shape[1] - 1
    if num_sources == 1:  # the only source's opinion is that of all
        return joint_scores(
            volume_of, regularizer, features, intrinsics, world_from_cam, hypotheses
        )
    if torch.is_grad_enabled() or torch.compiler.is_exporting():
        of_all = volume_of(features, intrinsics, world_from_cam, hypotheses)
        of_each = volume_of(
            pairs_with_reference(features),
            pairs_with_reference(intrinsics),
            pairs_with_reference(world_from_cam),
            hypotheses[:, None].expand(-1, num_sources, -1, -1, -1).flatten(0, 1),
        )
        scores = regularizer(torch.cat([of_all, of_each])).float()
        by_all, by_each = scores.tensor_split([len(features)])
        total = by_all + by_each.unflatten(0, (len(features), num_sources)).sum(dim=1)
    else:
        total = hypotheses.new_zeros(())
        pairs = [slice(0, source + 1, source) for source in range(1, num_sources + 1)]
        for views in (slice(None), *pairs):
            sweep = (features[:, views], intrinsics[:, views], world_from_cam[:, views], hypotheses)
            total = total + regularizer(volume_of(*sweep)).float()
    return total / (1 + num_sources)


def pairs_with_reference(of_views: Tensor) -> Tensor:
    """(batch, view, ...) to (batch x source, 2, ...): the reference's, then the source's."""
    sources = of_views[:, 1:]
    return torch.stack([of_views[:, :1].expand_as(sources), sources], dim=2).flatten(0, 1)
