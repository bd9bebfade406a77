"""Exported files give what PyTorch gives, in ONNX Runtime."""

import ast
import json
import runpy
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from PIL import Image

from mvsam import weights
from mvsam.build import build
from mvsam.cli import main
from mvsam.data.dataset import TupleDataset
from mvsam.data.formats import open_scene
from mvsam.data.labels import SCANNET20
from mvsam.inference.onnx import export_onnx
from mvsam.model import MultiViewSAM
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.mvs.votes import joint_scores, voted_scores
from mvsam.segmentation.decoder import SemanticDecoder
from mvsam.types import Model, Views
from mvsam.weights import ASSETS, WeightsInfo
from tests.small import random_views, shuffle_statistics, small_model
from tests.synthetic import write_posed_folder

EXAMPLE = Path(__file__).parents[2] / "examples" / "onnx_predict.py"
SIZE = (96, 64)


def shallow_model(name: str) -> MultiViewSAM:
    """Every kind of layer of the model once or twice; tracing time grows with their number."""
    model = small_model(name).eval()
    encoder, decoder = model.semantic_encoder, model.decoder
    assert encoder is not None and isinstance(decoder, SemanticDecoder)
    shuffle_statistics(model)
    encoder.backbone.blocks = encoder.backbone.blocks[:2]
    decoder.transformer.blocks = decoder.transformer.blocks[:1]
    model.info, model.weights_hash = WeightsInfo(name, depth_range=(0.2, 6.0)), "0123"
    return model


@pytest.fixture(scope="module")
def posed(tmp_path_factory) -> tuple[MultiViewSAM, Path]:
    """The full network, shallow, and the file that the command makes of it."""
    model, path = shallow_model("base"), tmp_path_factory.mktemp("onnx") / "base.onnx"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(weights, "load", lambda name: model)
        assert main(["export", "base", "--out", str(path), "--size", *map(str, SIZE)]) == 0
    return model, path


def open_session(path: Path) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def outputs_of(path: Path, views: Views) -> dict[str, np.ndarray]:
    session = open_session(path)
    inputs = {value.name: getattr(views, value.name).numpy() for value in session.get_inputs()}
    names = [value.name for value in session.get_outputs()]
    return {n: np.asarray(v) for n, v in zip(names, session.run(names, inputs), strict=True)}


def differences(model: Model, path: Path, views: Views) -> dict[str, np.ndarray]:
    """Absolute, pixel by pixel, between the file and PyTorch; every output must be there."""
    with torch.no_grad():
        prediction = model(views)
    expected = {
        name: values.numpy().astype(np.float64)
        for name in ("depth", "confidence", "labels", "logits")
        if (values := getattr(prediction, name)) is not None
    }
    actual = outputs_of(path, views)
    assert set(actual) == set(expected)
    return {name: np.abs(actual[name] - expected[name]) for name in expected}


def test_votes_of_sources_are_counted_for_any_number_of_views(tmp_path: Path):
    model, path = shallow_model("tiny"), tmp_path / "tiny.onnx"
    cascade = model.cascade
    assert cascade is not None
    first = cascade.regularizers[0]
    assert isinstance(first, CostRegularizer)
    first.score.weight.data *= 300  # untrained it finds all hypotheses alike
    export_onnx(model, path, SIZE)
    for num_views in (2, 3, 4):
        views = random_views(1, num_views, SIZE[1], SIZE[0], seed=3)
        cascade.first_scores = voted_scores
        off = differences(model, path, views)
        assert off["depth"].max() < 1e-3 and off["confidence"].max() < 1e-3
        cascade.first_scores = joint_scores
        if num_views > 2:
            assert differences(model, path, views)["depth"].max() > 1e-2


@pytest.mark.parametrize("num_views", [2, 3, 5])
def test_the_file_gives_what_pytorch_gives_for_any_number_of_views(posed, num_views: int):
    model, path = posed
    off = differences(model, path, random_views(1, num_views, SIZE[1], SIZE[0], seed=num_views))
    assert off["depth"].shape == (1, SIZE[1], SIZE[0])
    # Float32 in another order; depth is metres, logits are some tens.
    assert off["depth"].max() < 1e-4 and off["confidence"].max() < 1e-4
    assert off["logits"].max() < 1e-3
    assert (off["labels"] > 0).mean() < 1e-3  # where two classes are as likely


def test_poses_and_depth_range_are_inputs_and_not_frozen_into_the_file(posed):
    _, path = posed
    views = random_views(height=SIZE[1], width=SIZE[0])
    depth = outputs_of(path, views)["depth"]
    assert depth.min() >= 0.1 and depth.max() <= 5.5
    views.depth_range[:] = torch.tensor([10.0, 20.0])
    far = outputs_of(path, views)["depth"]
    assert far.min() >= 10 and far.max() <= 21
    views.world_from_cam[:, 1:, 0, 3] += 0.3
    moved = outputs_of(path, views)["depth"]
    assert np.abs(moved - far).max() > 1e-4  # ten times what rounding does to 15 m


def test_the_model_stays_as_it_was(posed):
    model, _ = posed
    fused = [module.fused_attn for module in model.modules() if hasattr(module, "fused_attn")]
    assert fused and all(fused)
    assert any(isinstance(module, torch.nn.BatchNorm3d) for module in model.modules())


def test_the_file_says_what_its_user_needs(posed):
    session = open_session(posed[1])
    about = {k: json.loads(v) for k, v in session.get_modelmeta().custom_metadata_map.items()}
    assert about["model"] == "base" and about["weights_hash"] == "0123"
    assert about["input_size"] == list(SIZE) and about["depth_range"] == [0.2, 6.0]
    assert tuple(about["classes"]) == SCANNET20.names
    assert [tuple(color) for color in about["palette"]] == list(SCANNET20.colors)
    shapes = {value.name: value.shape for value in session.get_inputs()}
    assert shapes["images"] == [1, "views", 3, SIZE[1], SIZE[0]]
    assert shapes["world_from_cam"] == [1, "views", 4, 4]
    types = {value.name: value.type for value in session.get_outputs()}
    assert types["labels"] == "tensor(uint8)" and types["depth"] == "tensor(float)"


def test_a_model_of_one_view_asks_for_what_it_reads_and_no_more(tmp_path: Path):
    model, path = shallow_model("tiny_semantic_gt_depth"), tmp_path / "rgbd.onnx"
    export_onnx(model, path, SIZE)
    names = {value.name for value in open_session(path).get_inputs()}
    assert names == {"images", "depth_range", "measured_depth"}
    views = random_views(num_views=1, height=SIZE[1], width=SIZE[0], measured=True)
    assert differences(model, path, views)["logits"].max() < 1e-3


def test_the_example_needs_neither_torch_nor_mvsam(posed, tmp_path: Path, monkeypatch, capsys):
    nodes = list(ast.walk(ast.parse(EXAMPLE.read_text())))
    modules = {alias.name for n in nodes if isinstance(n, ast.Import) for alias in n.names}
    modules |= {n.module for n in nodes if isinstance(n, ast.ImportFrom) and n.module}
    assert modules == {"argparse", "json", "pathlib", "numpy", "onnxruntime", "PIL"}
    write_posed_folder(tmp_path / "room", 3, (64, 48))
    arguments = [str(posed[1]), str(tmp_path / "room"), "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), *arguments])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    assert "median depth" in capsys.readouterr().out
    depth = np.load(tmp_path / "out/depth.npy")
    assert depth.shape == (SIZE[1], SIZE[0]) and 0.2 <= depth.min() <= depth.max() <= 7
    with Image.open(tmp_path / "out/labels.png") as labels:
        assert labels.size == SIZE


@pytest.mark.parametrize("size", [("100", "64"), ("0", "0")])
def test_a_size_that_does_not_fit_is_an_input_error(size, tmp_path: Path, capsys):
    arguments = ["export", "tiny", "--out", str(tmp_path / "x.onnx"), "--size", *size]
    assert main(arguments) == 2
    assert "multiples of 32" in capsys.readouterr().err
    assert not (tmp_path / "x.onnx").exists()


def test_missing_libraries_are_named_with_their_extra(monkeypatch, tmp_path: Path, capsys):
    monkeypatch.setitem(sys.modules, "onnxscript", None)
    assert main(["export", "tiny", "--out", str(tmp_path / "x.onnx")]) == 2
    assert "pip install 'mvsam[export]'" in capsys.readouterr().err


@pytest.fixture(scope="module")
def sample() -> Views:
    """The first tuple of the sample room, 320x256."""
    _, views, _ = TupleDataset([open_scene(ASSETS / "sample")], tuples_per_scene=1)[0]
    return views


@pytest.mark.slow
def test_embedded_tiny_in_full_size(sample: Views, tmp_path: Path):
    path = tmp_path / "tiny.onnx"
    assert main(["export", "tiny", "--out", str(path)]) == 0
    off = differences(weights.load("tiny"), path, sample)
    assert np.quantile(off["depth"], 0.99) < 1e-4
    # Where a distribution over planes has two peaks, rounding of float32 moves the next window.
    assert off["depth"].max() < 0.01 and off["logits"].max() < 0.05


@pytest.mark.slow
def test_cas_mvsnet_in_full_size(sample: Views, tmp_path: Path):
    model, path = build("cas_mvsnet").eval(), tmp_path / "cas_mvsnet.onnx"
    model.info = WeightsInfo("cas_mvsnet")
    export_onnx(model, path)
    off = differences(model, path, sample)
    assert set(off) == {"depth", "confidence"} and off["depth"].max() < 1e-4
