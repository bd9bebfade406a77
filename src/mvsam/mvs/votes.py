"""Each source view's own opinion in the first sweep, beside that of all views together.

One variance over all views takes a view that looks elsewhere, or that stands a little off where it
is said to stand, for a mismatch of them all. So the same network also scores the reference beside
each source alone. Not in the paper, whose variance (Eq. 2) is one of the opinions; of our networks
`tiny` alone does it. What it is worth: docs/log.md.
"""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

VolumeOf = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
"""`cost_volume.variance_volume`, or its specification."""
Regularizer = Callable[[Tensor], Tensor]
"""Volumes to scores before the softmax over planes."""


def voted_scores(
    volume_of: VolumeOf,
    regularizer: Regularizer,
    features: Float[Tensor, "batch view channel height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    world_from_cam: Float[Tensor, "batch view 4 4"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch plane height width"]:
    """Mean of the scores by all views and by each source alone.

    After the softmax that is the geometric mean of their probabilities. In use one opinion comes
    after the other, in the memory of one. In training all volumes pass the regularizer at once, so
    that its batch norms see what they see in use; in an exported graph too, whose number of views
    is free.
    """
    num_sources = features.shape[1] - 1
    sweep = (features, intrinsics, world_from_cam, hypotheses)
    if num_sources == 1:
        return regularizer(volume_of(*sweep))  # the only source's is that of all
    if torch.is_grad_enabled() or torch.compiler.is_exporting():
        pairs = volume_of(
            beside_reference(features),
            beside_reference(intrinsics),
            beside_reference(world_from_cam),
            hypotheses[:, None].expand(-1, num_sources, -1, -1, -1).flatten(0, 1),
        )
        scores = regularizer(torch.cat([volume_of(*sweep), pairs])).float()
        of_all, of_each = scores.tensor_split([len(features)])
        total = of_all + of_each.unflatten(0, (len(features), num_sources)).sum(dim=1)
    else:
        total = regularizer(volume_of(*sweep)).float()
        for source in range(1, 1 + num_sources):
            pair = features[:, [0, source]], intrinsics[:, [0, source]]
            volume = volume_of(*pair, world_from_cam[:, [0, source]], hypotheses)
            total += regularizer(volume).float()
    return total / (1 + num_sources)


def beside_reference(of_views: Tensor) -> Tensor:
    """(batch, view, ...) to (batch x source, 2, ...): the reference's, then the source's."""
    sources = of_views[:, 1:]
    return torch.stack([of_views[:, :1].expand_as(sources), sources], dim=2).flatten(0, 1)
