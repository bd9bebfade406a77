r"""What photos gain from correcting each other: `mvsam predict` with and without `--alone`.

    python benchmarks/fused.py DATA/redkitchen_a DATA/tum_fr3_cabinet --poses refined
    python benchmarks/fused.py rooms:val:0-24 --out results/fused_rooms.json

Every photo of a scene, or every reference that its `views.txt` lists, is predicted once, from as
many views as `--views`; what was predicted of it alone is scored beside what its neighbours made
of it, within 0.1 to 5 m. Scenes of one data set are one row.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from jaxtyping import Float32
from rich.console import Console
from rich.table import Table

from mvsam.data.catalog import open_data
from mvsam.data.labels import classes_of_model
from mvsam.data.transforms import resize_nearest
from mvsam.errors import InputError
from mvsam.evaluation.metrics import ConfusionMatrix, DepthMetrics, rel_of_most_confident
from mvsam.evaluation.protocols import PROTOCOLS
from mvsam.inference.outputs import OutputFolder
from mvsam.inference.scene import predict_scene
from mvsam.provenance import provenance
from mvsam.reconstruction.fusion import PhotoMaps
from mvsam.types import Frame, Model, Scene
from mvsam.weights import load

PROTOCOL = PROTOCOLS["real"]


class Tally:
    """Scores of the maps of many photos."""

    def __init__(self, num_classes: int):
        self.depth = DepthMetrics()
        self.halves: list[float] = []
        self.medians: list[float] = []
        self.labels = ConfusionMatrix.empty(num_classes)

    def add(self, maps: PhotoMaps, frame: Frame) -> None:
        if frame.depth is not None:
            self._add_depth(maps, frame.depth.astype(np.float32))
        if maps.labels is not None and frame.labels is not None:
            labels, truth = (
                torch.from_numpy(resize_nearest(values, PROTOCOL.size).astype(np.int64))
                for values in (maps.labels, frame.labels)
            )
            num_classes = len(self.labels.counts)
            self.labels += ConfusionMatrix.of_labels(labels, truth, num_classes)

    def _add_depth(self, maps: PhotoMaps, truth: Float32[np.ndarray, "height width"]) -> None:
        depth, confidence, target = (
            torch.from_numpy(resize_nearest(values, PROTOCOL.size))
            for values in (maps.depth, maps.confidence, truth)
        )
        valid = PROTOCOL.valid_depth(target)
        self.depth += DepthMetrics.of_image(depth, target, valid)
        half = rel_of_most_confident(depth, confidence, target, valid, 0.5)
        if half is not None:
            self.halves.append(half)
            error = (depth - target).abs()[valid] / target[valid]
            self.medians.append(error.median().item())

    def scores(self) -> dict:
        """Fractions."""
        miou = self.labels.miou() if self.labels.counts.any() else None
        return {
            "num_images": self.depth.num_images,
            "rel": self.depth.scores()["rel"],
            "median": _mean(self.medians),
            "rel_of_confident_half": _mean(self.halves),
            "miou": miou,
        }


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def measure(
    model: Model, scenes: Sequence[Scene], num_views: int, size: tuple[int, int] | None
) -> dict:
    """Scores of each photo alone, and of what its neighbours made of it."""
    num_classes = len(classes_of_model(model))
    alone, fused, seconds, photos = Tally(num_classes), Tally(num_classes), 0.0, 0
    for scene in scenes:
        with TemporaryDirectory() as out:
            result = predict_scene(model, scene, out, num_views=num_views, size=size)
            folder = OutputFolder(Path(out))
            run = folder.read_run()
            assert run is not None
            if "own_depth" not in folder.kinds:
                raise InputError("only maps of depth with a confidence correct each other.")
            seconds, photos = seconds + run["seconds"].get("fuse", 0), photos + len(result.written)
            for index in range(len(scene)):
                frame = scene.frame(index)
                if folder.is_done(frame.name):
                    alone.add(folder.own_maps(frame.name), frame)
                    fused.add(folder.maps(frame.name), frame)
    return {
        "alone": alone.scores(),
        "fused": fused.scores(),
        "seconds_a_photo": round(seconds / photos, 3),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", nargs="+", help="scenes, as mvsam predict")
    parser.add_argument("--model", default="tiny", help="name, weights file or hub id")
    parser.add_argument("--poses", choices=("given", "refined"), default="given")
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--size", type=int, nargs=2, help="for the network, as mvsam predict")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    model, poses = load(arguments.model).eval(), arguments.poses
    rows = {
        Path(name).name: measure(
            model, list(open_data(name, poses=poses)), arguments.views, arguments.size
        )
        for name in arguments.data
    }
    Console(width=120).print(table(rows))
    if arguments.out:
        about = {"model": arguments.model, "weights_hash": model.weights_hash}
        about |= {"poses": poses, "num_views": arguments.views, "size": arguments.size}
        about |= provenance()
        arguments.out.write_text(json.dumps(about | {"data": rows}, indent=2) + "\n")


def table(rows: dict) -> Table:
    """One row a data set: alone, then fused."""
    result = Table("data", "photos", "Rel", "median", "confident half", "mIoU", "s a photo")
    for name, row in rows.items():
        pairs = [
            " ".join(
                "-" if of[key] is None else f"{of[key]:.4f}" for of in (row["alone"], row["fused"])
            )
            for key in ("rel", "median", "rel_of_confident_half", "miou")
        ]
        photos = str(row["alone"]["num_images"])
        result.add_row(name, photos, *pairs, f"{row['seconds_a_photo']:.2f}")
    return result


if __name__ == "__main__":
    main()
