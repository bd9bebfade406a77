"""Where models run."""

import pytest
import torch
from torch import nn

from mvsam.device import device_of, find_device
from mvsam.errors import InputError


@pytest.mark.parametrize("asked", ["cuda", "gpu"])
def test_the_processor_is_taken_where_it_is_asked_for_and_a_gpu_where_there_is_one(
    monkeypatch, asked: str
):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert [find_device(name) for name in ("auto", asked, "cpu")] == ["cuda", "cuda", "cpu"]
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert [find_device(name) for name in ("auto", "cpu")] == ["cpu", "cpu"]
    with pytest.raises(InputError, match="no CUDA device was found: leave --accelerator out"):
        find_device(asked, "--accelerator")


def test_a_model_is_where_its_parameters_are():
    assert device_of(nn.Linear(2, 2, device="meta")).type == "meta"
    assert device_of(nn.Identity()).type == "cpu"
