"""What `--poses refined` does to depth: exact cameras of rooms, displaced ones, and both refined.

    python benchmarks/refined_poses.py tiny --data rooms:val --limit 100 \\
        --out results/refined_poses.json

Every camera is displaced anew, by Gaussian errors along and about each of its axes. Real
photographs are scored by `benchmarks/real.py --poses refined`.
"""

import argparse
import json
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from mvsam.data.catalog import open_data
from mvsam.data.dataset import TupleDataset
from mvsam.data.refined import RefinedScene
from mvsam.data.sampling import evenly_spaced
from mvsam.data.streaming.augment import with_pose_noise
from mvsam.data.wrapped import WrappedScene
from mvsam.evaluation.evaluate import Sample, evaluate
from mvsam.evaluation.protocols import PROTOCOLS, Protocol
from mvsam.provenance import provenance
from mvsam.types import Frame, Model, Scene
from mvsam.weights import load


class DisplacedScene(WrappedScene):
    """Its cameras as a tracker might give them."""

    def __init__(self, scene: Scene, metres: float, degrees: float):
        super().__init__(scene)
        self._spread = metres, degrees

    def frame(self, index: int) -> Frame:
        dice = np.random.default_rng((zlib.crc32(self.name.encode()), index))
        return with_pose_noise(super().frame(index), *self._spread, dice)


def score(model: Model, scenes: list[Scene], limit: int, protocol: Protocol) -> dict:
    """Of at most `limit` tuples of three photos, evenly spaced."""
    data = TupleDataset(scenes, 3, protocol.size)
    chosen = evenly_spaced(range(len(data)), limit)

    def samples() -> Iterator[Sample]:
        return (data[index] for index in chosen)

    totals = evaluate(model, samples(), protocol, precision="auto").as_json()
    return {key: value for key, value in totals.items() if key != "scenes"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("model", nargs="?", default="tiny", help="name or weights file")
    parser.add_argument("--data", default="rooms:val")
    parser.add_argument("--limit", type=int, default=100, help="at most so many tuples")
    parser.add_argument("--metres", type=float, default=0.008, help="spread along each axis")
    parser.add_argument("--degrees", type=float, default=0.3, help="spread about each axis")
    parser.add_argument("--cache", help="folder to keep rendered rooms in")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    model, protocol = load(arguments.model), PROTOCOLS["paper"]
    exact = list(open_data(arguments.data, cache=arguments.cache))
    displaced = [DisplacedScene(s, arguments.metres, arguments.degrees) for s in exact]
    cameras = {
        "exact": exact,
        "exact, refined": [RefinedScene(scene) for scene in exact],
        "displaced": displaced,
        "displaced, refined": [RefinedScene(scene) for scene in displaced],
    }
    scores = {
        name: score(model, scenes, arguments.limit, protocol) for name, scenes in cameras.items()
    }
    table = Table("cameras", "abs", "rel", "delta_1.03", "miou")
    for name, values in scores.items():
        table.add_row(name, *(f"{values[key]:.3f}" for key in ("abs", "rel", "delta_1.03", "miou")))
    Console().print(table)
    if arguments.out:
        record = {
            "data": arguments.data,
            "model": arguments.model,
            "weights_hash": model.weights_hash,
            "metres": arguments.metres,
            "degrees": arguments.degrees,
            **provenance(),
            "scores": scores,
        }
        arguments.out.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
