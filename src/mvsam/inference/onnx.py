"""A model as one ONNX file: the whole posed network, cameras and depth range as inputs.

Inputs are the fields of `Views` that the model reads, batch 1; outputs are `depth`, `confidence`,
`labels` (uint8) and `logits`, those that the model has. docs/export.md has the table.
"""

import json
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from mvsam.build import Inputs, model_spec
from mvsam.convolution import fold_batch_norm
from mvsam.data.labels import SCANNET20
from mvsam.errors import MissingExtraError
from mvsam.files import write_whole
from mvsam.inference.photos import MOST_VIEWS, check_size
from mvsam.types import Model, Views

OPSET = 18
"""The first with antialiased resizing, which SAM's input needs."""

PER_VIEW = {"images", "intrinsics", "world_from_cam", "semantic_images"}
"""Fields of `Views` whose second axis is the view."""


def export_onnx(model: Model, path: Path, size: tuple[int, int] | None = None) -> None:
    """Writes the model as an ONNX file for pictures of `size` (width, height; None: its own).

    The model must say what it is (`model.info`, as `weights.load` gives it); it stays as it was.
    A model of posed views takes 2 to 8 of them, another one view. The file's metadata hold each
    field of `WeightsInfo` as JSON. Raises InputError for sides that are no multiples of 32.
    """
    _require_libraries()
    size = size or model.input_size
    check_size(size)
    inputs = _example_inputs(model, size)
    program = _onnx_program(_Graph(model), inputs)
    graph = program.model.graph
    for value in [value for value in graph.inputs if not value.uses()]:
        graph.inputs.remove(value)  # what this model does not read is not asked for
    program.model.metadata_props.update(_metadata(model, size))
    write_whole(path, lambda file: file.write(program.model_proto.SerializeToString()))


def _require_libraries() -> None:
    try:
        import onnx  # noqa: F401
        import onnxscript  # noqa: F401
    except ModuleNotFoundError as error:
        raise MissingExtraError("ONNX export", error.name or "onnxscript", "export") from error


class _Graph(nn.Module):
    """The model between named tensors, which is all that ONNX knows."""

    def __init__(self, model: Model):
        super().__init__()
        self.model = fold_batch_norm(model)
        for module in self.model.modules():
            if hasattr(module, "fused_attn"):  # its loop over pieces would fix the number of views
                module.fused_attn = False  # pyright: ignore

    def forward(self, inputs: dict[str, Tensor]) -> dict[str, Tensor]:
        prediction = self.model(Views(**inputs))
        labels = prediction.labels
        maps = {
            "depth": prediction.depth,
            "confidence": prediction.confidence,
            "labels": None if labels is None else labels.to(torch.uint8),
            "logits": prediction.logits,
        }
        return {name: values for name, values in maps.items() if values is not None}


def _example_inputs(model: Model, size: tuple[int, int]) -> dict[str, Tensor]:
    """Inputs of the right shapes; tracing does not look at their values."""
    width, height = size
    kind = model_spec(model.info.model).inputs
    num_views = 3 if kind is Inputs.VIEWS else 1
    inputs = {
        "images": torch.zeros(1, num_views, 3, height, width),
        "intrinsics": torch.eye(3).repeat(1, num_views, 1, 1),
        "world_from_cam": torch.eye(4).repeat(1, num_views, 1, 1),
        "depth_range": torch.tensor([model.info.depth_range]),
    }
    if kind is Inputs.RGBD:
        inputs["measured_depth"] = torch.ones(1, height, width)
    if model.semantic_size is not None:
        width, height = model.semantic_size
        inputs["semantic_images"] = torch.zeros(1, num_views, 3, height, width)
    return inputs


def _onnx_program(graph: _Graph, inputs: dict[str, Tensor]) -> torch.onnx.ONNXProgram:
    is_posed = inputs["images"].shape[1] > 1
    # With two views there is one source, and layouts that PyTorch would trace apart; the operations
    # are the same, so the file takes two as well.
    views = torch.export.Dim("views", min=3, max=MOST_VIEWS)
    axes = {name: {1: views} if is_posed and name in PER_VIEW else None for name in inputs}
    with torch.no_grad():
        # Apart from torch.onnx.export, which would quietly fix an axis that cannot be free.
        traced = torch.export.export(graph, (inputs,), dynamic_shapes=(axes,))
    outputs: Any = traced.call_spec.out_spec
    program = torch.onnx.export(
        traced,
        input_names=list(inputs),
        output_names=outputs.context,  # the keys of the dict that the graph returns
        dynamic_shapes=({name: {1: "views"} if name == "images" else None for name in inputs},),
        opset_version=OPSET,
        dynamo=True,
        verbose=False,
    )
    assert program is not None
    return program


def _metadata(model: Model, size: tuple[int, int]) -> dict[str, str]:
    """What a program needs to use the file, each value as JSON."""
    page = asdict(model.info) | {"input_size": size}
    if not page["classes"]:
        page |= {"classes": SCANNET20.names, "palette": SCANNET20.colors}
    page |= {"weights_hash": model.weights_hash, "mvsam": version("mvsam")}
    return {name: json.dumps(value) for name, value in page.items()}
