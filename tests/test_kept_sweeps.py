"""`benchmarks/kept_sweeps.py`: what is kept is what the context network sees."""

import importlib.util
from pathlib import Path

import pytest
import torch

from mvsam.errors import InputError
from mvsam.mvs.cascade import regress
from tests.small import random_targets, random_views, small_model

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "kept_sweeps.py"


@pytest.fixture(scope="module")
def kept_sweeps():
    spec = importlib.util.spec_from_file_location("kept_sweeps", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@torch.no_grad()
def test_what_is_kept_gives_the_depth_of_the_first_stage(kept_sweeps):
    model, views = small_model("tiny").eval(), random_views()
    assert model.cascade is not None and model.context is not None
    torch.nn.init.normal_(model.context.out.weight, std=0.1)  # else it changes nearly nothing
    kept = kept_sweeps.Kept.of(model, views, random_targets().depth)
    hypotheses = model.cascade.hypotheses(0, [], kept.tensors["depth"].shape[-2:], views)
    again = regress(model.context(*kept.inputs(hypotheses)), hypotheses)
    alone = regress(kept.tensors["scores"].float(), hypotheses)
    first = model(views).stages[0]
    off, changed = ((each.depth - first.depth).abs().mean() for each in (again, alone))
    assert off < 0.02 < 0.2 * changed


def test_a_mirror_twice_is_none(kept_sweeps):
    model = small_model("tiny").eval()
    kept = kept_sweeps.Kept.of(model, random_views(), random_targets().depth)
    once, twice = kept.mirrored(), kept.mirrored().mirrored()
    assert (once.tensors["scores"] != kept.tensors["scores"]).any()
    for name, values in kept.tensors.items():
        torch.testing.assert_close(twice.tensors[name], values)


def test_a_folder_without_sweeps_is_named(kept_sweeps, tmp_path: Path):
    with pytest.raises(InputError, match="holds no sweeps"):
        kept_sweeps.kept_in(tmp_path)
