import pytest
import torch

from mvsam.baselines.multi_task import (
    Distillation,
    MultiTaskLoss,
    ScaleFusion,
    as_prediction,
    resize_prediction,
)
from mvsam.types import IGNORE, Prediction, Targets

RANGE = torch.tensor([[0.1, 5.0]])


def constant(depth: float, logit: float, side: int) -> Prediction:
    """Two classes, the second `logit` above the first."""
    logits = torch.zeros(1, 2, side, side)
    logits[:, 1] = logit
    return Prediction(depth=torch.full((1, side, side), depth), logits=logits)


def test_side_outputs_count_as_much_as_the_final_one_at_the_picture_s_size():
    final, side = constant(2.5, 0.0, 4), constant(3.0, 1.0, 2)
    prediction = Prediction(final.depth, None, final.logits, auxiliary=(side,))
    labels = torch.zeros(1, 4, 4, dtype=torch.long)
    labels[:, 0] = IGNORE
    depth = torch.full((1, 4, 4), 2.0)
    depth[:, 1:] = torch.tensor([0.0, 0.05, 9.0])[:, None]  # unknown, too near, too far
    parts = MultiTaskLoss(depth_weight=10.0)(prediction, Targets(depth, labels), RANGE)
    assert parts["depth"].item() == pytest.approx(0.5 + 1.0)
    assert parts["segmentation"].item() == pytest.approx(0.693147 + 1.313262, abs=1e-5)
    assert parts["loss"].item() == pytest.approx(2.006409 + 15.0, abs=1e-4)


def test_resizing_is_bilinear_between_pixel_centres():
    prediction = as_prediction(
        {"depth": torch.tensor([[[[1.0, 3.0]]]]), "semantics": torch.tensor([[[[0.0, 4.0]]]])}
    )
    resized = resize_prediction(prediction, (1, 4))
    assert resized.depth is not None and resized.logits is not None
    assert resized.depth[0, 0].tolist() == [1.0, 1.5, 2.5, 3.0]
    assert resized.logits[0, 0, 0].tolist() == [0.0, 1.0, 3.0, 4.0]


def test_a_task_receives_what_the_gate_lets_through_of_the_other():
    distillation = Distillation(3)
    for task, gain in (("semantics", 2.0), ("depth", 4.0)):
        (message,), (gate,) = (
            part[task].parameters() for part in (distillation.message, distillation.gate)
        )
        torch.nn.init.dirac_(message)
        message.data *= gain
        torch.nn.init.zeros_(gate)  # sigmoid(0) is a half
    features = {"semantics": torch.rand(1, 3, 4, 4), "depth": torch.rand(1, 3, 4, 4)}
    told = distillation(features)
    torch.testing.assert_close(told["semantics"], features["semantics"] + 2 * features["depth"])
    torch.testing.assert_close(told["depth"], features["depth"] + features["semantics"])


def test_scales_are_stacked_finest_first_at_the_finest():
    fusion = ScaleFusion(3).eval()
    weight, bias = fusion[0].parameters()
    torch.nn.init.dirac_(weight)
    torch.nn.init.zeros_(bias)
    fine, coarse = torch.rand(1, 1, 4, 4), torch.rand(1, 2, 1, 1)
    fused = fusion([fine, coarse])
    # A fresh batch norm divides by sqrt(1 + 1e-5).
    torch.testing.assert_close(fused[:, :1], fine, rtol=1e-4, atol=0)
    torch.testing.assert_close(fused[:, 1:], coarse.expand(1, 2, 4, 4), rtol=1e-4, atol=0)
