"""Scores on real photographs: every sequence below a folder, under protocol `real`.

    python benchmarks/real.py DATA --model tiny --out results/real.json

A sequence is a scene folder with a `views.txt`, or a folder of such scenes (small groups that
count as one sequence). The per-image median of the true depth stands beside the model: no constant
does better in absolute error.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from mvsam.data.catalog import scene_folders
from mvsam.data.dataset import TupleDataset
from mvsam.data.formats import find_format, open_scene
from mvsam.data.sampling import evenly_spaced
from mvsam.evaluation.evaluate import Sample, Scores, evaluate
from mvsam.evaluation.protocols import PROTOCOLS, Protocol
from mvsam.evaluation.yardsticks import MeasuredMedianDepth
from mvsam.precision import autocast
from mvsam.provenance import provenance
from mvsam.weights import load


def sequences(folder: Path) -> dict[str, list[Path]]:
    """Name -> scene folders, of those that prescribe their view tuples."""
    found = {}
    for path in sorted(p for p in folder.iterdir() if p.is_dir()):
        scenes = [path] if find_format(path) else scene_folders(path)
        scenes = [scene for scene in scenes if (scene / "views.txt").exists()]
        if scenes:
            found[path.name] = scenes
    return found


class SequenceSamples:
    """The samples of one sequence, at most the protocol's number of tuples in all."""

    def __init__(self, name: str, scenes: Sequence[Path], protocol: Protocol, num_views: int):
        self.name = name
        self.data = TupleDataset(
            [open_scene(path) for path in scenes], num_views, protocol.size, protocol.depth_range
        )
        tuples = [(index,) for index in range(len(self.data))]
        self.chosen = [index for (index,) in evenly_spaced(tuples, protocol.tuples_per_scene)]

    def __iter__(self) -> Iterator[Sample]:
        for index in self.chosen:
            _, views, targets = self.data[index]
            yield self.name, views, targets


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="folder of sequences")
    parser.add_argument("--model", default="tiny", help="name, weights file or hub id")
    parser.add_argument("--views", type=int, default=3, help="reference and sources")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    protocol, model = PROTOCOLS["real"], load(arguments.model)
    scores, constant = Scores(protocol.name), Scores(protocol.name)
    for name, scenes in sequences(arguments.data).items():
        samples = SequenceSamples(name, scenes, protocol, arguments.views)
        with autocast("cpu"):
            scores += evaluate(model, samples, protocol)
        constant += evaluate(MeasuredMedianDepth(protocol), samples, protocol)
    report(scores, constant)
    if arguments.out:
        record = {
            "model": arguments.model,
            "weights_hash": getattr(model, "weights_hash", None),
            "num_views": arguments.views,
            **provenance(),
            **scores.as_json(),
            "per_image_median": constant.as_json()["scenes"],
        }
        arguments.out.write_text(json.dumps(record, indent=2) + "\n")


def report(scores: Scores, constant: Scores) -> None:
    table = Table("sequence", "images", "Rel", "Rel of the median", "delta 1.25", "mIoU")
    for name, scene in scores.scenes.items():
        values, median = scene.as_json(), constant.scenes[name].as_json()
        cells = [values["rel"], median["rel"], values["delta_1.25"], values["miou"]]
        table.add_row(
            name, str(scene.num_images), *("-" if x is None else f"{x:.3f}" for x in cells)
        )
    Console().print(table)


if __name__ == "__main__":
    main()
