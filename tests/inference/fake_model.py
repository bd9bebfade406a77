"""Models that need no weights: they repeat the measured depth and colour-code the classes."""

from copy import copy
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from mvsam.types import Model, Prediction, Views


@dataclass(frozen=True)
class FakeFeatures:
    images: Tensor

    @staticmethod
    def join(parts: list["FakeFeatures"]) -> "FakeFeatures":
        return FakeFeatures(torch.cat([part.images for part in parts], dim=1))


class FakeModel(Model):
    """Depth is the measured one (else 2 m), the class the strongest of the colours 0, 1, 2."""

    input_size: tuple[int, int] = (64, 48)

    def __init__(self, has_depth: bool = True, has_labels: bool = True, reads_depth: bool = True):
        super().__init__()
        self.scale = nn.Parameter(torch.ones(1))
        self.has_depth, self.has_labels = has_depth, has_labels
        self.reads_depth = reads_depth
        self.encoded: list[int] = []
        """Views of each call of `encode`."""
        self.fail_at: tuple[int, BaseException] | None = None
        """(number of the decode call, what it raises)."""
        self.decoded: list[Views] = []

    def __deepcopy__(self, memo: dict) -> "FakeModel":
        """A session works on a copy; what it does shows in the lists of the original."""
        return copy(self)

    @property
    def encoded_views(self) -> int:
        return sum(self.encoded)

    def encode(self, views: Views) -> FakeFeatures:
        self.encoded.append(views.num_views)
        return FakeFeatures(views.images)

    def decode(self, features: FakeFeatures, views: Views, reference: int = 0) -> Prediction:
        assert not self.training
        assert features.images.shape == views.images.shape
        self.decoded.append(views)
        if self.fail_at and len(self.decoded) == self.fail_at[0]:
            raise self.fail_at[1]
        image = features.images[:, reference]
        depth = views.measured_depth
        depth = torch.full_like(image[:, 0], 2.0) if depth is None else depth
        return Prediction(
            depth=depth if self.has_depth else None,
            confidence=torch.full_like(depth, 0.75) if self.has_depth else None,
            logits=image if self.has_labels else None,
        )

    def forward(self, views: Views) -> Prediction:
        return self.decode(self.encode(views), views)


class WholeModel(Model):
    """A model that is only called as a whole, as some baselines: depth 3 m."""

    input_size: tuple[int, int] = (64, 48)

    def forward(self, views: Views) -> Prediction:
        return Prediction(depth=torch.full_like(views.images[:, 0, 0], 3.0))
