"""Whether confidence means anything: without the least sure pixels, is the error smaller?"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True)
class Sparsification:
    """Sums over images of per-image sparsification errors; a score is the mean over images.

    Images without a valid pixel count nowhere. `a + b` merges two accumulators.
    """

    num_images: int = 0
    ause: float = 0.0
    """Area under the sparsification error of Rel, a fraction: 0 if confidence orders the pixels as
    their errors do (Ilg et al., ECCV 2018; here without their division by the whole image's error,
    so that scores keep a unit)."""

    @staticmethod
    def of_image(
        predicted: Float[Tensor, "height width"],
        confidence: Float[Tensor, "height width"],
        truth: Float[Tensor, "height width"],
        valid: Bool[Tensor, "height width"],
    ) -> "Sparsification":
        """The score of one image over its valid pixels, where `truth` must be positive, metres."""
        if not valid.any():
            return Sparsification()
        depth = truth[valid].double()
        error = (predicted[valid].double() - depth).abs() / depth
        ours = _curve(_shared_by_equals(error, confidence[valid]), confidence[valid])
        ideal = _curve(error, -error)
        return Sparsification(num_images=1, ause=(ours - ideal).mean().item())

    def __add__(self, other: "Sparsification") -> "Sparsification":
        return Sparsification(self.num_images + other.num_images, self.ause + other.ause)

    def score(self) -> float | None:
        """The mean AUSE; None without a valid image."""
        return self.ause / self.num_images if self.num_images else None


def _curve(
    error: Float[Tensor, " pixel"], confidence: Float[Tensor, " pixel"]
) -> Float[Tensor, " pixel"]:
    """Mean error of the 1, 2, ... most confident pixels."""
    ordered = error[confidence.argsort(descending=True)]
    kept = torch.arange(1, len(error) + 1, device=error.device)
    return ordered.cumsum(0) / kept


def _shared_by_equals(
    error: Float[Tensor, " pixel"], confidence: Float[Tensor, " pixel"]
) -> Float[Tensor, " pixel"]:
    """Each pixel's error, averaged over pixels of the same confidence: their order is no merit."""
    _, group, counts = confidence.unique(return_inverse=True, return_counts=True)
    sums = torch.zeros(len(counts), dtype=error.dtype, device=error.device)
    return (sums.index_add(0, group, error) / counts)[group]
