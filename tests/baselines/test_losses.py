"""What the losses of several baselines share."""

import pytest
import torch

from mvsam.baselines.adapnet_pp import AdapNetPPLoss
from mvsam.baselines.emsaformer import EmsaFormerLoss
from mvsam.baselines.mt_refinenet import MtRefineNetLoss
from mvsam.baselines.multi_task import MultiTaskLoss
from mvsam.types import Prediction, Targets

LOSSES = (AdapNetPPLoss, EmsaFormerLoss, MtRefineNetLoss, MultiTaskLoss)


def prediction(right_of_class_one: float) -> Prediction:
    """Class 0 is recognised; class 1 by so much, at every output."""
    logits = torch.zeros(1, 2, 1, 2)
    logits[0, 0, 0, 0], logits[0, 1, 0, 1] = 3.0, right_of_class_one
    depth = torch.ones(1, 1, 2)
    side = Prediction(depth=depth, logits=logits)
    return Prediction(depth=depth, logits=logits, auxiliary=(side, side))


TARGETS = Targets(torch.ones(1, 1, 2), torch.tensor([[[0, 1]]]))
DEPTH_RANGE = torch.tensor([[0.1, 5.0]])


@pytest.mark.parametrize("loss", LOSSES)
def test_a_class_of_weight_zero_teaches_nothing_and_without_weights_all_do(loss: type):
    def total(weights: tuple[float, ...] | None, right: float) -> float:
        parts = loss(class_weights=weights)(prediction(right), TARGETS, DEPTH_RANGE)
        return parts["loss"].item()

    assert total((1.0, 0.0), 3.0) == pytest.approx(total((1.0, 0.0), -3.0))
    assert total(None, 3.0) < total(None, -3.0)
    assert total((1.0, 1.0), -3.0) == pytest.approx(total(None, -3.0))
