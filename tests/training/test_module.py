import pytest
import torch

from mvsam.training.losses import JointLoss
from mvsam.training.module import TrainingModule, predict_references
from mvsam.training.optim import OptimizerConfig
from mvsam.types import Prediction, Targets, Views
from tests.small import random_targets, random_views, small_model


def module_for(model: torch.nn.Module, logged: dict) -> TrainingModule:
    """A module without a trainer, whose log is a dict."""
    module = TrainingModule(model, JointLoss(), OptimizerConfig(), (0.1, 5.0))
    module.log = lambda name, value, **_: logged.update({name: value})  # pyright: ignore
    return module


def test_each_view_in_turn_is_predicted_as_if_it_came_first():
    model, views = small_model("tiny").eval(), random_views()
    with torch.no_grad():
        predictions = predict_references(model, views, 3)
        for order, prediction in zip(([0, 1, 2], [1, 0, 2], [2, 0, 1]), predictions, strict=True):
            reordered = Views(
                views.images[:, order],
                views.intrinsics[:, order],
                views.world_from_cam[:, order],
                views.depth_range,
            )
            expected = model(reordered)
            assert prediction.logits is not None
            torch.testing.assert_close(prediction.depth, expected.depth, atol=1e-4, rtol=1e-4)
            torch.testing.assert_close(prediction.logits, expected.logits, atol=1e-3, rtol=1e-3)


def test_views_are_encoded_once_for_all_references(monkeypatch):
    model, calls = small_model("tiny").eval(), []
    encode = model.encode
    monkeypatch.setattr(model, "encode", lambda views: (calls.append(1), encode(views))[1])
    predict_references(model, random_views(), 3)
    assert len(calls) == 1


def test_the_loss_of_a_step_is_the_mean_over_the_references():
    model, views = small_model("tiny").eval(), random_views()
    targets = [random_targets(seed=seed) for seed in range(2)]
    logged: dict = {}
    loss = module_for(model, logged).training_step((views, targets, None), 0)
    parts = [
        JointLoss()(prediction, target, views.depth_range)["loss"]
        for prediction, target in zip(predict_references(model, views, 2), targets, strict=True)
    ]
    torch.testing.assert_close(loss, torch.stack(parts).mean())
    assert set(logged) == {"train/loss", "train/depth", "train/segmentation", "train/prior"}


def test_single_photos_add_the_loss_of_their_labels_and_prior_times_its_weight():
    model, views, logged = small_model("tiny").eval(), random_views(), {}
    target = random_targets()
    singles, labels = random_views(batch=2, num_views=1, measured=True), random_targets(batch=2)
    module = module_for(model, logged)
    alone = module.training_step((views, [target], None), 0)
    module.singles_weight = 0.5
    loss = module.training_step((views, [target], (singles, labels)), 0)
    expected = JointLoss()(model.segment(singles), labels, singles.depth_range)
    assert set(expected) == {"loss", "segmentation", "prior"}
    torch.testing.assert_close(loss, alone + 0.5 * expected["loss"])
    torch.testing.assert_close(logged["train/singles"], expected["loss"])


def test_only_the_parts_that_are_named_learn():
    model, views = small_model("tiny"), random_views()
    names = ("cascade.regularizers.0", "prior")
    module = TrainingModule(model, JointLoss(), OptimizerConfig(lr=1e-2), (0.1, 5.0), parts=names)
    module.log = lambda *_, **__: None  # pyright: ignore
    before = {name: value.clone() for name, value in model.state_dict().items()}
    module.train()
    optimizer = module.configure_optimizers()["optimizer"]
    module.training_step((views, [random_targets()], None), 0).backward()
    optimizer.step()
    changed = {n for n, value in model.state_dict().items() if not torch.equal(value, before[n])}
    assert changed and all(name.startswith(names) for name in changed)
    assert any("running_mean" in name for name in changed), "their batch norms follow the data"
    for name in names:
        assert any(n.startswith(name) and n.endswith("weight") for n in changed)


class Knows(torch.nn.Module):
    """Says what it is told."""

    def __init__(self, depth: float, label: int):
        super().__init__()
        self.depth, self.label = depth, label

    def forward(self, views: Views) -> Prediction:
        batch, size = len(views.images), (views.height, views.width)
        logits = torch.zeros(batch, 20, *size)
        logits[:, self.label] = 1
        return Prediction(torch.full((batch, *size), self.depth), None, logits)


def test_validation_logs_rel_and_miou_over_all_batches():
    logged: dict = {}
    module = module_for(Knows(2.0, 3), logged)
    module.on_validation_epoch_start()
    for depth, label in ((2.0, 3), (4.0, 3), (4.0, 5)):
        targets = Targets(torch.full((1, 32, 32), depth), torch.full((1, 32, 32), label))
        module.validation_step((["room"], random_views(height=32, width=32), targets), 0)
    module.on_validation_epoch_end()
    assert logged["val/rel"] == pytest.approx((0 + 0.5 + 0.5) / 3)
    assert logged["val/miou"] == pytest.approx((2 / 3 + 0) / 2)


def test_a_scene_that_two_processes_looked_at_counts_once(monkeypatch):
    """`all_gather_object` hands every process the shares of all."""
    logged: dict = {}
    module = module_for(Knows(2.0, 3), logged)
    shares = []
    for scenes in ((("a", 2.0), ("c", 4.0)), (("b", 4.0), ("a", 2.0))):
        module.on_validation_epoch_start()
        for name, depth in scenes:
            targets = Targets(torch.full((1, 32, 32), depth), torch.full((1, 32, 32), 3))
            module.validation_step(([name], random_views(height=32, width=32), targets), 0)
        shares.append(module.scores)
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 2)
    monkeypatch.setattr(
        torch.distributed,
        "all_gather_object",
        lambda gathered, own: gathered.__setitem__(slice(None), shares),
    )
    module.on_validation_epoch_end()
    assert logged["val/rel"] == pytest.approx((0 + 0.5 + 0.5) / 3)


def test_scores_do_not_leak_from_one_validation_into_the_next():
    logged: dict = {}
    module = module_for(Knows(2.0, 3), logged)
    for depth, rel in ((4.0, 0.5), (2.0, 0.0)):
        module.on_validation_epoch_start()
        targets = Targets(torch.full((1, 32, 32), depth), torch.full((1, 32, 32), 3))
        module.validation_step((["room"], random_views(height=32, width=32), targets), 0)
        module.on_validation_epoch_end()
        assert logged["val/rel"] == pytest.approx(rel)
