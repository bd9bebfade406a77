"""benchmarks/sweep_gpu.py as far as it goes without a GPU."""

import runpy
import sys
from pathlib import Path

import pytest
import torch

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "sweep_gpu.py"


@pytest.fixture(scope="module")
def script() -> dict:
    return runpy.run_path(str(SCRIPT))


def test_without_a_gpu_it_says_what_it_needs(script, monkeypatch, capsys):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(sys, "argv", ["sweep_gpu.py"])
    with pytest.raises(SystemExit) as stopped:
        script["main"]()
    assert stopped.value.code == 2
    assert "run it where torch.cuda.is_available() is true" in capsys.readouterr().err


def test_least_bytes_count_each_input_and_output_once(script):
    features = torch.empty(1, 3, 8, 4, 5, dtype=torch.bfloat16)
    image, volume = 8 * 4 * 5 * 2, 6 * 8 * 4 * 5 * 2
    depths = torch.empty(1, 6, 4, 5)
    expected = 3 * image + depths.nbytes + volume, 6 * image + depths.nbytes + volume
    assert script["least_bytes"](features, depths) == expected
    planes = torch.empty(1, 6, 1, 1).expand(1, 6, 4, 5)
    expected = 3 * image + 6 * 4 + volume, 6 * image + 6 * 4 + volume
    assert script["least_bytes"](features, planes) == expected


def test_every_stage_of_the_cascade_is_a_sound_problem(script):
    for stage in script["STAGES"]:
        features, _, _, hypotheses = script["problem"](stage, 2, 3, 32, 16)
        size = 16 // stage.reduction, 32 // stage.reduction
        assert features.shape == (2, 3, stage.channels, *size)
        assert hypotheses.shape == (2, stage.planes, *size)
        assert (hypotheses.diff(dim=1) > 0).all() and (hypotheses > 0).all()
