import time
from unittest import mock

import pytest
import torch
from lightning import LightningModule, Trainer

from mvsam.experiments.throughput import Throughput
from tests.small import random_targets, random_views


def test_speed_counts_samples_and_references_of_all_processes_but_not_validation(monkeypatch):
    clock = iter([10.0, 12.0, 100.0, 106.0])
    monkeypatch.setattr(time, "perf_counter", lambda: next(clock))
    logged: dict = {}
    module = mock.Mock(
        spec=LightningModule,
        device=torch.device("cpu"),
        log_dict=lambda values, **_: logged.update(values),
    )
    trainer = mock.Mock(spec=Trainer, world_size=2)
    batch = (random_views(batch=2), [random_targets(batch=2)] * 3, None)
    throughput = Throughput()

    def end_of_step() -> None:
        throughput.on_train_batch_end(trainer, module, None, batch, 0)

    end_of_step()
    assert not logged  # nothing to compare with yet
    end_of_step()
    assert logged["train/samples_per_s"] == pytest.approx(2 * 2 / 2.0)
    throughput.on_validation_end()
    end_of_step()  # at 100 s, after a long look at the validation scenes
    end_of_step()
    assert logged["train/samples_per_s"] == pytest.approx(2 * 4 / 8.0)
    assert logged["train/references_per_s"] == pytest.approx(3 * logged["train/samples_per_s"])
    assert logged["train/peak_gib"] > 0.01
