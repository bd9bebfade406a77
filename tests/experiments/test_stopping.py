"""Runs that end early: what they leave, and that going on from there changes nothing."""

import os
import signal
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import pytest
import torch
from lightning import LightningModule, Trainer
from safetensors.torch import load_file

from mvsam.data.streaming.stream import SampleStream
from mvsam.experiments.stopping import SafeStop
from mvsam.training.module import TrainingModule
from tests.experiments.small_run import drive, run, with_singles

pytestmark = pytest.mark.filterwarnings("ignore")  # Lightning's and TensorBoard's own


@contextmanager
def ctrl_c_in_step(step: int):
    """Somebody presses Ctrl-C while this step is computed."""
    training_step = TrainingModule.training_step

    def interrupted(module: TrainingModule, *batch):
        if module.trainer.global_step == step:
            os.kill(os.getpid(), signal.SIGINT)
        return training_step(module, *batch)

    with mock.patch.object(TrainingModule, "training_step", interrupted):
        yield


@contextmanager
def unreadable_from(first: int):
    """The disk fails at this sample."""
    read = SampleStream.__getitem__

    def failing(stream: SampleStream, n: int):
        if n >= first:
            raise OSError("the disk is gone")
        return read(stream, n)

    with mock.patch.object(SampleStream, "__getitem__", failing):
        yield


def saved_step(folder: Path) -> int:
    return torch.load(folder / "last.ckpt", weights_only=True)["global_step"]


def test_stopped_by_ctrl_c_and_by_an_error_a_run_ends_with_the_weights_of_one_never_stopped(
    data: Path, finished: Path, tmp_path: Path, caplog
):
    handler = signal.getsignal(signal.SIGINT)
    with ctrl_c_in_step(2), pytest.raises(KeyboardInterrupt):
        run(tmp_path, data)
    assert saved_step(tmp_path) == 3  # the step was finished; the regular checkpoint is step 2
    assert f"{tmp_path / 'last.ckpt'} holds step 3; the same command goes on" in caplog.text
    assert signal.getsignal(signal.SIGINT) is handler
    assert not (tmp_path / "model.safetensors").exists()
    with unreadable_from(12), pytest.raises(OSError, match="the disk is gone"):
        run(tmp_path, data)
    assert saved_step(tmp_path) == 5  # the loader reads one batch ahead
    resumed = load_file(run(tmp_path, data))
    expected = load_file(finished / "model.safetensors")
    assert all(torch.equal(resumed[key], expected[key]) for key in expected)


def test_a_run_with_labelled_single_photos_goes_on_as_if_never_stopped(data: Path, tmp_path: Path):
    experiment = with_singles(data, steps=4)
    whole = load_file(drive(experiment, tmp_path / "whole", devices=1))
    with unreadable_from(8), pytest.raises(OSError, match="the disk is gone"):
        drive(experiment, tmp_path / "parts", devices=1)
    assert saved_step(tmp_path / "parts") == 3
    resumed = load_file(drive(experiment, tmp_path / "parts", devices=1))
    assert all(torch.equal(resumed[key], whole[key]) for key in whole)


def at_step_8(**changes) -> mock.Mock:
    """A trainer; its run began at step 5."""
    strategy = mock.Mock(reduce_boolean_decision=lambda asked, all: asked)
    defaults = {"global_step": 8, "world_size": 1, "is_global_zero": True, "strategy": strategy}
    return mock.Mock(spec=Trainer, **(defaults | changes))


class OneLayer(LightningModule):
    def __init__(self):
        super().__init__()
        self.layer = torch.nn.BatchNorm1d(2)


def end_with_an_error(
    trainer: mock.Mock, module: LightningModule, *, is_between_steps: bool = True
) -> list[mock._Call]:
    """What is saved when training ends with an error."""
    stop = SafeStop(Path("last.ckpt"))
    stop.on_train_start(at_step_8(global_step=5), module)
    stop.on_before_optimizer_step(trainer, module, None)
    if is_between_steps:
        stop.on_train_batch_end(trainer, module)
    stop.on_exception(trainer, module, ValueError())
    return trainer.save_checkpoint.mock_calls


SAVED = [mock.call(Path("last.ckpt"), weights_only=False)]


def test_whole_steps_are_saved_when_something_goes_wrong():
    assert end_with_an_error(at_step_8(), OneLayer()) == SAVED


def test_an_error_while_the_optimiser_works_leaves_the_regular_checkpoint():
    assert not end_with_an_error(at_step_8(), OneLayer(), is_between_steps=False)


def test_a_diverged_run_leaves_the_regular_checkpoint():
    module = OneLayer()
    module.state_dict()["layer.running_mean"].fill_(torch.nan)
    assert not end_with_an_error(at_step_8(), module)


def test_a_run_that_took_no_step_leaves_nothing():
    assert not end_with_an_error(at_step_8(global_step=5), OneLayer())


def test_one_process_of_several_does_not_save_alone():
    assert not end_with_an_error(at_step_8(world_size=2), OneLayer())


def test_all_processes_stop_where_one_was_asked_to():
    stop, module = SafeStop(Path("last.ckpt")), OneLayer()
    somebody_was = mock.Mock(reduce_boolean_decision=lambda asked, all: True)
    trainer = at_step_8(world_size=2, strategy=somebody_was)
    stop.on_train_start(at_step_8(global_step=5), module)
    with pytest.raises(KeyboardInterrupt):
        stop.on_train_batch_end(trainer)
    stop.on_exception(trainer, module, KeyboardInterrupt())
    assert trainer.save_checkpoint.mock_calls == SAVED


def test_a_checkpoint_that_cannot_be_written_does_not_hide_what_went_wrong(caplog):
    full = mock.Mock(side_effect=OSError("no space left"))
    end_with_an_error(at_step_8(save_checkpoint=full), OneLayer())
    assert "step 8 could not be saved: no space left" in caplog.text


def test_the_second_ctrl_c_stops_at_once():
    stop = SafeStop(Path("last.ckpt"))
    with pytest.raises(KeyboardInterrupt), stop.listening():
        os.kill(os.getpid(), signal.SIGINT)
        assert stop.is_asked
        os.kill(os.getpid(), signal.SIGINT)
