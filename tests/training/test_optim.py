import pytest
import torch

from mvsam.training.optim import (
    SGD,
    Adam,
    Milestones,
    OneCycle,
    OptimizerConfig,
    Polynomial,
    make_optimizer,
    parameter_groups,
    rate_factor,
)
from tests.small import small_model


def rates(model, steps: int, config: OptimizerConfig) -> list[list[float]]:
    """The rate of each group at each step."""
    optimizer, schedule = make_optimizer(model, config)
    seen = []
    for _ in range(steps):
        seen.append([group["lr"] for group in optimizer.param_groups])
        optimizer.step()
        schedule.step()
    return seen


def test_tuned_blocks_of_sam_learn_at_a_tenth_of_the_rate():
    model = small_model("base", tuned_blocks=3)
    rest, tuned = parameter_groups(model, OptimizerConfig())
    assert (rest["lr"], tuned["lr"]) == (1e-3, 1e-4)
    assert model.semantic_encoder is not None
    expected = {id(p) for p in model.semantic_encoder.parameters() if p.requires_grad}
    assert {id(p) for p in tuned["params"]} == expected
    learned = [p for p in model.parameters() if p.requires_grad]
    assert len(rest["params"]) + len(tuned["params"]) == len(learned)


@pytest.mark.parametrize(
    "name, options", [("base", {"tuned_blocks": 0}), ("tiny", {}), ("cas_mvsnet", {})]
)
def test_without_tuned_blocks_there_is_one_group_of_all_that_learns(name: str, options: dict):
    model = small_model(name, **options)
    (group,) = parameter_groups(model, OptimizerConfig())
    assert group["lr"] == 1e-3
    assert {id(p) for p in group["params"]} == {
        id(p) for p in model.parameters() if p.requires_grad
    }


def test_optimizer_is_the_paper_s_adamw():
    optimizer, _ = make_optimizer(torch.nn.Linear(2, 2), OptimizerConfig())
    assert isinstance(optimizer, torch.optim.AdamW)
    group = optimizer.param_groups[0]
    assert (group["betas"], group["weight_decay"]) == ((0.9, 0.999), 1e-2)


@pytest.mark.parametrize("steps, warmup", [(100_000, 500), (10_000, 200), (1_000, 20), (10, 1)])
def test_the_rate_warms_up_from_a_third_over_2_percent_and_at_most_500_steps(steps, warmup):
    factor = rate_factor(OptimizerConfig(steps=steps))
    assert factor(0) == pytest.approx(1 / 3)
    assert factor(warmup // 2) == pytest.approx(1 / 3 + 2 / 3 * (warmup // 2) / warmup)
    assert factor(warmup - 1) < 1 and factor(warmup) == 1


def test_the_rate_halves_at_10_12_and_14_sixteenths():
    factor = rate_factor(OptimizerConfig(steps=1600))
    for edge, before, after in ((1000, 1, 0.5), (1200, 0.5, 0.25), (1400, 0.25, 0.125)):
        assert factor(edge - 1) == before and factor(edge) == after
    assert factor(1599) == 0.125


def test_both_groups_follow_the_schedule():
    model = small_model("base", tuned_blocks=1)
    seen = rates(model, 16, OptimizerConfig(steps=16))
    assert seen[0] == pytest.approx([1e-3 / 3, 1e-4 / 3])
    assert seen[5] == pytest.approx([1e-3, 1e-4])
    assert seen[10] == pytest.approx([5e-4, 5e-5])
    assert seen[15] == pytest.approx([1.25e-4, 1.25e-5])


def test_a_publication_s_algorithm_and_weight_decay_are_used():
    model = torch.nn.Linear(2, 2)
    adam, _ = make_optimizer(model, OptimizerConfig(algorithm=Adam(), weight_decay=1e-4))
    assert type(adam) is torch.optim.Adam and adam.param_groups[0]["weight_decay"] == 1e-4
    descent, _ = make_optimizer(model, OptimizerConfig(algorithm=SGD(nesterov=True)))
    assert isinstance(descent, torch.optim.SGD)
    group = descent.param_groups[0]
    assert (group["momentum"], group["nesterov"]) == (0.9, True)


def test_without_warm_up_and_milestones_the_rate_is_constant():
    constant = Milestones(shares=(), warmup_steps=0)
    assert {constant(step, 100) for step in range(100)} == {1.0}


def test_mvs2d_s_rate_falls_to_a_tenth_at_epochs_25_and_28_of_30():
    schedule = Milestones(shares=(25 / 30, 28 / 30), factor=0.1, warmup_steps=0)
    seen = [schedule(step, 3000) for step in (0, 2499, 2500, 2800)]
    assert seen == pytest.approx([1, 1, 0.1, 0.01])


def test_polynomial_decay_ends_at_zero():
    schedule = Polynomial(0.9)
    assert [schedule(step, 100) for step in (0, 50, 100)] == pytest.approx([1, 0.5**0.9, 0])


def test_one_cycle_may_rise_to_the_very_end():
    assert OneCycle(rising=1.0)(10, 10) == 1.0


def test_one_cycle_is_torch_s():
    optimizer = torch.optim.SGD(torch.nn.Linear(1, 1).parameters(), lr=1.0)
    # torch counts 101 rates from the first to the last, and puts the top one before its share.
    reference = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, 1.0, total_steps=101, pct_start=11 / 101, cycle_momentum=False
    )
    for step in range(101):
        assert OneCycle()(step, 100) == pytest.approx(optimizer.param_groups[0]["lr"], abs=1e-6)
        optimizer.step()
        if step < 100:
            reference.step()


def test_a_model_may_say_how_fast_its_parts_learn():
    class Halves(torch.nn.Linear):
        def parameter_groups(self, lr: float):
            return [{"params": [self.weight], "lr": lr}, {"params": [self.bias], "lr": 20 * lr}]

    groups = parameter_groups(Halves(2, 2), OptimizerConfig(lr=0.1))
    assert [group["lr"] for group in groups] == pytest.approx([0.1, 2.0])
