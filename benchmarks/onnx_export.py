"""Exported files beside PyTorch, on the first tuple of the sample room: differences and seconds.

    python benchmarks/onnx_export.py tiny cas_mvsnet --out results/onnx_export.json

A model without embedded weights gets random ones. Differences are absolute, largest over all
pixels; seconds are those of the processor, medians on one thread, float32 on both sides.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np
import onnxruntime
import torch

from mvsam.build import build
from mvsam.data.dataset import TupleDataset
from mvsam.data.formats import open_scene
from mvsam.files import write_json
from mvsam.inference.onnx import export_onnx
from mvsam.provenance import provenance
from mvsam.types import Model, Prediction
from mvsam.weights import ASSETS, WeightsInfo, embedded, load

Result = TypeVar("Result")


def model_of(name: str) -> Model:
    if name in embedded():
        return load(name)
    torch.manual_seed(0)
    model = build(name).eval()
    model.info = WeightsInfo(name)
    return model


def compare(name: str, folder: Path, repeats: int) -> dict:
    """Differences and seconds of one model."""
    model, path = model_of(name), folder / f"{name}.onnx"
    seconds_to_export, _ = timed(lambda: export_onnx(model, path), repeats=1)
    _, views, _ = TupleDataset([open_scene(ASSETS / "sample")], size=model.input_size)[0]
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    inputs = {value.name: getattr(views, value.name).numpy() for value in session.get_inputs()}
    names = [value.name for value in session.get_outputs()]
    with torch.inference_mode():
        ours, prediction = timed(lambda: model(views), repeats)
    theirs, values = timed(lambda: session.run(names, inputs), repeats)
    outputs = {name: np.asarray(v) for name, v in zip(names, values, strict=True)}
    return {
        "weights": "embedded" if name in embedded() else "random",
        "megabytes": round(path.stat().st_size / 1e6, 1),
        "seconds_to_export": round(seconds_to_export, 1),
        "seconds_pytorch": round(ours, 2),
        "seconds_onnxruntime": round(theirs, 2),
        **differences(prediction, outputs),
    }


def differences(prediction: Prediction, outputs: dict[str, np.ndarray]) -> dict[str, float]:
    found = {}
    for name, values in outputs.items():
        off = np.abs(values - getattr(prediction, name).numpy().astype(np.float64))
        if name == "labels":
            found["share_of_labels"] = float((off > 0).mean())
        else:
            found[name] = float(off.max())
    return {f"difference_{name}": value for name, value in found.items()}


def timed(work: Callable[[], Result], repeats: int) -> tuple[float, Result]:
    """Median processor seconds (a busy machine stretches them less), and the last result."""
    seconds, results = [], []
    for _ in range(repeats):
        start = time.process_time()
        results.append(work())
        seconds.append(time.process_time() - start)
    return median(seconds), results[-1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("models", nargs="+", help="names")
    parser.add_argument("--repeats", type=int, default=3, help="the median of so many counts")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    report = {**provenance(), "onnxruntime": onnxruntime.__version__, "models": {}}
    with TemporaryDirectory() as folder:
        for name in arguments.models:
            report["models"][name] = compare(name, Path(folder), arguments.repeats)
            print(name, report["models"][name])
    if arguments.out:
        write_json(arguments.out, report)


if __name__ == "__main__":
    main()
