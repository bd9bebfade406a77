"""Scores on procedural rooms beside two constant answers, under protocol `paper`.

    python benchmarks/rooms.py tiny --data rooms:val --limit 100 --out results/rooms_val.json

Rooms are photographed at 320x256, or at the size of `--photos`; the network sees them at that of
`--size`; scores stay at 320x256. With `--fuse` every view of a tuple is predicted, and all correct
each other, as in `mvsam.predict`; that of the reference is scored.
The constants are the median depth and the most frequent label of the very tuples that are scored:
the best that an answer without looking can do.
"""

import argparse
import json
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from torch.nn.functional import one_hot

from mvsam.data.catalog import open_data
from mvsam.data.dataset import TupleDataset
from mvsam.data.sampling import evenly_spaced
from mvsam.errors import InputError
from mvsam.evaluation.evaluate import Sample, evaluate
from mvsam.evaluation.protocols import PROTOCOLS
from mvsam.evaluation.yardsticks import (
    ConstantMedianDepth,
    MajorityLabel,
    majority_label,
    median_depth,
)
from mvsam.provenance import provenance
from mvsam.reconstruction.fusion import PhotoMaps, corrections
from mvsam.reconstruction.thinning import ThinnedCamera, thin
from mvsam.training.module import predict_references
from mvsam.types import Model, Prediction, Views
from mvsam.weights import load


class Tuples:
    """Some tuples of a data set, evenly spaced; read once, then kept."""

    def __init__(self, data: TupleDataset, limit: int | None):
        self.indices = evenly_spaced(range(len(data)), limit)
        self.read = lru_cache(maxsize=None)(data.__getitem__)

    def __iter__(self) -> Iterator[Sample]:
        return (self.read(index) for index in self.indices)


class Corrected:
    """A model whose predictions of a tuple's views correct each other; says those of view 0."""

    def __init__(self, model: Model):
        self.model = model

    def __call__(self, views: Views) -> Prediction:
        predictions = predict_references(self.model, views, views.num_views)
        cameras, maps = _cameras(views), [_maps_of(prediction) for prediction in predictions]
        better = corrections(cameras, maps)[0].applied(maps[0], cameras[0])
        depth, confidence = (torch.from_numpy(x)[None] for x in (better.depth, better.confidence))
        logits = predictions[0].logits
        if logits is not None and better.labels is not None:
            chosen = torch.from_numpy(better.labels.astype(np.int64))
            logits = one_hot(chosen, logits.shape[1]).movedim(-1, 0)[None].float()
        return Prediction(depth, confidence, logits)


def _maps_of(prediction: Prediction) -> PhotoMaps:
    assert prediction.depth is not None and prediction.confidence is not None
    labels = prediction.labels
    return PhotoMaps(
        prediction.depth[0].float().numpy(),
        prediction.confidence[0].float().numpy(),
        None if labels is None else labels[0].numpy().astype(np.uint8),
    )


def _cameras(views: Views) -> list[ThinnedCamera]:
    size = (views.width, views.height)
    pairs = zip(views.intrinsics[0], views.world_from_cam[0], strict=True)
    return [
        thin(size, intrinsics.double().numpy(), pose.double().numpy(), max(size))
        for intrinsics, pose in pairs
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("models", nargs="+", help="names or weights files")
    parser.add_argument("--data", default="rooms:val")
    parser.add_argument("--limit", type=int, help="at most so many tuples, evenly spaced")
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument(
        "--photos", type=int, nargs=2, default=(320, 256), help="width and height of the rooms'"
    )
    parser.add_argument(
        "--size", type=int, nargs=2, default=(320, 256), help="for the network, as mvsam predict"
    )
    parser.add_argument(
        "--fuse", action="store_true", help="views correct each other, as mvsam predict"
    )
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    protocol = PROTOCOLS["paper"]
    models = {name: load(name) for name in arguments.models}
    rooms = open_data(arguments.data, room_size=tuple(arguments.photos), cache="cache/rooms")

    def samples_at(size: tuple[int, int]) -> Tuples:
        data = TupleDataset(rooms, arguments.views, size, truth_size=protocol.truth_size)
        return Tuples(data, arguments.limit)

    samples = samples_at(protocol.size)
    depth = median_depth((targets for _, _, targets in samples), protocol)
    label = majority_label(targets for _, _, targets in samples)
    if depth is None or label is None:
        raise InputError(f"{arguments.data} has no depth or no labels to score against.")
    constants = {
        "constant median depth": ConstantMedianDepth(depth),
        "majority label": MajorityLabel(label),
    }
    scores = {name: evaluate(answer, samples, protocol) for name, answer in constants.items()}
    for name, model in models.items():
        size = tuple(arguments.size)
        seen = samples if size == protocol.size else samples_at(size)
        answer = Corrected(model.eval()) if arguments.fuse else model
        scores[name] = evaluate(answer, seen, protocol, precision="auto")
    totals = {
        name: {k: v for k, v in result.as_json().items() if k != "scenes"}
        for name, result in scores.items()
    }
    report(totals)
    if arguments.out:
        record = {
            "data": arguments.data,
            "num_views": arguments.views,
            "photos": arguments.photos,
            "size": arguments.size,
            "fuse": arguments.fuse,
            **provenance(),
            "scores": totals,
        }
        arguments.out.write_text(json.dumps(record, indent=2) + "\n")


def report(totals: dict[str, dict]) -> None:
    columns = ("abs", "rel", "rmse", "delta_1.03", "delta_1.25", "miou", "num_images")
    table = Table("answer", *columns)
    for name, values in totals.items():
        cells = [values[column] for column in columns]
        table.add_row(name, *("-" if x is None else f"{x:.3f}" for x in cells))
    Console().print(table)


if __name__ == "__main__":
    main()
