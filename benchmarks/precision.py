"""What bfloat16 costs in accuracy: a model in both precisions on the same tuples, one a scene.

    python benchmarks/precision.py tiny --data rooms:val --out results/precision.json

`rel` and `miou` are scores under protocol `paper`. `depth_difference` is the mean over all pixels
of |bfloat16 depth - float32 depth| / float32 depth, `labels_changed` the share of pixels that get
another label.
"""

import argparse
from pathlib import Path

import torch
from rich.progress import track

from mvsam.convolution import fold_batch_norm
from mvsam.data.catalog import open_data
from mvsam.data.dataset import TupleDataset
from mvsam.evaluation.evaluate import SceneScores, score_item
from mvsam.evaluation.protocols import PROTOCOLS
from mvsam.files import write_json
from mvsam.precision import Precision, autocast
from mvsam.provenance import provenance
from mvsam.types import Model, Prediction, Views
from mvsam.weights import load

PRECISIONS: tuple[Precision, ...] = ("float32", "bfloat16")


def compare(model: Model, data: TupleDataset, device: str) -> dict:
    """Scores in each precision, and how far the maps themselves are apart."""
    scores = {precision: SceneScores() for precision in PRECISIONS}
    apart: dict[str, list[float]] = {"depth_difference": [], "labels_changed": []}
    for index in track(range(len(data)), description="precision"):
        _, views, targets = data[index]
        exact, rounded = (predict(model, views.to(device), name) for name in PRECISIONS)
        for name, prediction in zip(PRECISIONS, (exact, rounded), strict=True):
            scores[name] += score_item(prediction, targets.to(device), 0, PROTOCOLS["paper"])
        if exact.depth is not None and rounded.depth is not None:
            difference = (rounded.depth - exact.depth).abs() / exact.depth
            apart["depth_difference"].append(difference.mean().item())
        if exact.labels is not None:
            apart["labels_changed"].append((rounded.labels != exact.labels).float().mean().item())
    return {
        **{name: scores[name].as_json() for name in PRECISIONS},
        **{name: sum(values) / len(values) for name, values in apart.items() if values},
    }


def predict(model: Model, views: Views, precision: Precision) -> Prediction:
    with torch.inference_mode(), autocast(views.images.device.type, precision):
        return model(views)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("models", nargs="+", help="names or weights files")
    parser.add_argument("--data", default="rooms:val")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    data = TupleDataset(open_data(arguments.data), tuples_per_scene=1)
    found = {}
    for name in arguments.models:
        model = fold_batch_norm(load(name)).to(device)  # as `mvsam predict` runs it
        found[name] = compare(model, data, device)
    for name, record in found.items():
        for precision in PRECISIONS:
            values = {key: record[precision][key] for key in ("rel", "miou")}
            print(name, precision, *(f"{k} {v:.4f}" for k, v in values.items() if v is not None))
        print(name, *(f"{k} {v:.5f}" for k, v in record.items() if k not in PRECISIONS))
    if arguments.out:
        write_json(arguments.out, {"data": arguments.data, **provenance(device), "models": found})


if __name__ == "__main__":
    main()
