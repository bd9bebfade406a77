import torch

from mvsam.baselines.pad_net import PadNet
from tests.baselines.counting import count
from tests.small import random_views


def test_parameters_are_those_of_the_release():
    with torch.device("meta"):
        model = PadNet()
    assert count(model) == 7_008_776
    assert count(model.fusion) == 73_710
    assert count(model.initial) + count(model.initial_head) == 428_053
    assert count(model.distillation) == 2_359_296
    assert count(model.final) + count(model.final_head) == 286_997


def test_the_initial_prediction_comes_along_at_a_quarter_of_the_picture():
    with torch.no_grad():
        prediction = PadNet(5).eval()(random_views(num_views=1))
    (initial,) = prediction.auxiliary
    assert initial.depth is not None and initial.depth.shape == (1, 8, 16)
    assert initial.logits is not None and initial.logits.shape == (1, 5, 8, 16)
    assert prediction.depth is not None and prediction.depth.shape == (1, 32, 64)


def test_each_task_s_final_depth_hears_of_the_other_task():
    """Semantic features reach the depth only by distillation."""
    torch.manual_seed(0)
    model, views = PadNet(5).eval(), random_views(num_views=1)
    with torch.no_grad():
        before = model(views)
        model.initial["semantics"][-1].bn3.bias += 1.0  # pyright: ignore
        after = model(views)
    assert not torch.equal(before.depth, after.depth)
    assert torch.equal(before.auxiliary[0].depth, after.auxiliary[0].depth)
