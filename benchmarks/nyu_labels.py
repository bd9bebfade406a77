"""Label scores on the tenth of NYUv2's training images that no run here is trained on.

    python benchmarks/nyu_labels.py ../shared/data/nyuv2_train --model tiny --out results/nyu.json

The images are single ones, so no stereo depth is to be had: the decoder's prompt is the sensor's
depth, at the network's size. mIoU over ScanNet's 20 classes, from one confusion matrix over all
images, at 320x256.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from mvsam.data.dataset import make_targets, make_views
from mvsam.data.labels import SCANNET20
from mvsam.data.readers.single_views import SingleViews
from mvsam.data.streaming.name_lists import read_names
from mvsam.evaluation.metrics import ConfusionMatrix
from mvsam.model import MultiViewSAM
from mvsam.precision import autocast
from mvsam.provenance import provenance
from mvsam.types import Frame
from mvsam.weights import load

SIZE, DEPTH_RANGE = (320, 256), (0.1, 5.0)


def score(model: MultiViewSAM, frames: Sequence[Frame]) -> ConfusionMatrix:
    """Of all frames together."""
    counts = np.zeros((len(SCANNET20), len(SCANNET20) + 1), np.int64)
    for frame in frames:
        views = make_views([frame], SIZE, DEPTH_RANGE, model.semantic_size)
        with torch.inference_mode(), autocast("cpu"):
            labels = model.segment(views).labels
        assert labels is not None
        truth = make_targets(frame, SIZE).labels
        counts += ConfusionMatrix.of_labels(labels[0], truth[0], len(SCANNET20)).counts
    return ConfusionMatrix(counts)


def report(matrix: ConfusionMatrix, num_images: int) -> None:
    table = Table("class", "IoU %", title=f"{num_images} held-out images of NYUv2")
    for name, value in zip(SCANNET20.names, matrix.iou(), strict=True):
        table.add_row(name, "-" if value is None else f"{100 * value:.1f}")
    table.add_section()
    for name, value in (("mean", matrix.miou()), ("pixels right", matrix.accuracy())):
        table.add_row(name, "-" if value is None else f"{100 * value:.1f}")
    Console().print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="folder nyuv2_train")
    parser.add_argument("--model", default="tiny", help="name, weights file or hub id")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    scenes = SingleViews(arguments.data, only=read_names("nyuv2_heldout"))
    frames, model = [scene.frame(0) for scene in scenes], load(arguments.model)
    if not isinstance(model, MultiViewSAM) or model.decoder is None:
        parser.error(f"{arguments.model} cannot label single images")
    matrix = score(model, frames)
    report(matrix, len(frames))
    if arguments.out:
        record = {
            "model": arguments.model,
            "weights_hash": model.weights_hash,
            **provenance(),
            "protocol": "nyuv2_heldout: 320x256, prompted with measured depth",
            "num_images": len(frames),
            "miou": matrix.miou(),
            "accuracy": matrix.accuracy(),
            "iou": dict(zip(SCANNET20.names, matrix.iou(), strict=True)),
        }
        arguments.out.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
