"""Scores on real photographs: every sequence below a folder, under protocol `real`.

    python benchmarks/real.py DATA --model tiny --out results/real.json --page docs/results.md

A sequence is a scene folder with a `views.txt`, or a folder of such scenes (small groups that
count as one sequence). The per-image median of the true depth stands beside the model: no constant
does better in absolute error. Where tuples have four sources, five views stand beside three of the
same tuples. Models are chosen by `--part choose`; `--part report` leaves those tuples out.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from mvsam.data.catalog import scene_folders
from mvsam.data.dataset import TupleDataset
from mvsam.data.formats import Poses, find_format, open_scene
from mvsam.data.sampling import evenly_spaced, view_tuples
from mvsam.evaluation.evaluate import SceneScores, Scores, at_truth_size, evaluate, score_item
from mvsam.evaluation.metrics import rel_of_most_confident
from mvsam.evaluation.protocols import PROTOCOLS, Protocol
from mvsam.evaluation.yardsticks import MeasuredMedianDepth
from mvsam.precision import autocast
from mvsam.provenance import provenance
from mvsam.types import Model, Scene, Targets, Views
from mvsam.weights import load

CHOSEN_BY = ("icl_livingroom5_synthetic", "nyu_dining5")
SHARED = "livingroom1_synthetic"
"""Of it every second tuple chooses and the others report."""
FEW, MANY = 3, 5


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
    """The samples of one sequence, at most the protocol's number of tuples in all.

    size: (width, height) of the pictures that the network sees. part: `choose`, `report` or `all`.
    only_many: leave out tuples without `MANY` views.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        protocol: Protocol,
        num_views: int,
        size: tuple[int, int],
        part: str = "all",
        only_many: bool = False,
        semantic_size: tuple[int, int] | None = None,
    ):
        self.data = TupleDataset(
            scenes,
            num_views,
            size,
            protocol.depth_range,
            semantic_size=semantic_size,
            truth_size=protocol.truth_size,
        )
        chosen = evenly_spaced(range(len(self.data)), protocol.tuples_per_scene)
        self.chosen = [n for n in chosen if is_in(part, scenes[0].name, n)]
        if only_many:
            lengths = [
                len(views)
                for scene in scenes
                for views in view_tuples(scene, MANY, protocol.depth_range)[0]
            ]
            assert len(lengths) == len(self.data), "tuples that see nothing are left out alike"
            self.chosen = [n for n in self.chosen if lengths[n] >= MANY]

    def __iter__(self) -> Iterator[tuple[Views, Targets]]:
        for index in self.chosen:
            yield self.data[index][1:]


def is_in(part: str, sequence: str, tuple_number: int) -> bool:
    """Whether a tuple serves to choose a model, or to report how good the chosen one is."""
    chooses = sequence in CHOSEN_BY or (sequence == SHARED and tuple_number % 2 == 0)
    return part == "all" or (part == "choose") == chooses


@dataclass(frozen=True)
class Outcome:
    """Of one sequence."""

    scores: SceneScores
    confident_half: float | None
    """Rel of the half of each image's pixels with the highest confidence, mean over images."""


def run(model: Model, samples: SequenceSamples, protocol: Protocol) -> Outcome:
    """Scores of the samples, and of their most confident halves."""
    scores, halves = SceneScores(), []
    for views, targets in samples:
        with torch.inference_mode(), autocast("cpu"):
            prediction = model(views)
        scores += score_item(prediction, targets, 0, protocol)
        if prediction.depth is None or prediction.confidence is None:
            continue
        truth = targets.depth[0]
        depth, confidence = (
            at_truth_size(values[0].float(), protocol.truth_size)
            for values in (prediction.depth, prediction.confidence)
        )
        valid = protocol.valid_depth(truth)
        halves.append(rel_of_most_confident(depth, confidence, truth, valid, 0.5))
    known = [half for half in halves if half is not None]
    return Outcome(scores, float(np.mean(known)) if known else None)


def measure(
    model: Model,
    data: Path,
    protocol: Protocol,
    part: str,
    poses: Poses = "given",
    size: tuple[int, int] | None = None,
) -> dict:
    """The record of a model: three views everywhere, five where there are as many.

    size: (width, height) at which the network sees photos; None: the protocol's.
    """
    few, many, same_few = Scores(protocol.name), Scores(protocol.name), Scores(protocol.name)
    constant, halves = Scores(protocol.name), {}
    for name, folders in sequences(data).items():
        scenes = [open_scene(folder, poses=poses) for folder in folders]
        given = partial(
            SequenceSamples,
            scenes,
            protocol,
            size=size or protocol.size,
            part=part,
            semantic_size=model.semantic_size,
        )
        samples = given(num_views=FEW)
        if not samples.chosen:
            continue
        outcome = run(model, samples, protocol)
        few.scenes[name], halves[name] = outcome.scores, outcome.confident_half
        seen_as_scored = SequenceSamples(scenes, protocol, FEW, protocol.size, part)
        named = ((name, *sample) for sample in seen_as_scored)
        constant += evaluate(MeasuredMedianDepth(protocol), named, protocol)
        more = given(num_views=MANY, only_many=True)
        if more.chosen:
            many.scenes[name] = run(model, more, protocol).scores
            fewer = given(num_views=FEW, only_many=True)
            same_few.scenes[name] = run(model, fewer, protocol).scores
    return {
        **few.as_json(),
        "rel_of_confident_half": halves,
        "five_views": many.as_json()["scenes"],
        "three_views_of_the_same": same_few.as_json()["scenes"],
        "per_image_median": constant.as_json()["scenes"],
    }


COLUMNS = (
    "sequence",
    "images",
    "Rel",
    "confident half",
    "5 views (3 of the same)",
    "median",
    "mIoU",
)


def rows(record: dict) -> list[list[str]]:
    """One a sequence; Rel as fractions."""

    def number(value: float | None) -> str:
        return "-" if value is None else f"{value:.3f}"

    found = []
    for name, scores in record["scenes"].items():
        five, three = (
            record[key].get(name, {}).get("rel")
            for key in ("five_views", "three_views_of_the_same")
        )
        more = "-" if five is None else f"{number(five)} ({number(three)})"
        half, median = (
            record["rel_of_confident_half"][name],
            record["per_image_median"][name]["rel"],
        )
        numbers = (
            number(scores["rel"]),
            number(half),
            more,
            number(median),
            number(scores["miou"]),
        )
        found.append([name, str(scores["num_images"]), *numbers])
    return found


def page(
    record: dict, labels: dict | None, refined: dict | None = None, larger: dict | None = None
) -> str:
    """The same in Markdown, with what made it.

    labels: what nyu_labels.py wrote. refined: the record with `--poses refined`. larger: that with
    `--size` as well.
    """
    lines = [
        "# Results on recorded and rendered sequences",
        "",
        f"`{record['model']}` (weights {record['weights_hash']}), commit {record['commit']}, "
        f"{record['date']}, protocol `real` (320x256, ground truth between 0.1 and 5 m, at most 24 "
        "tuples a sequence, mean of the per-image Rel).",
        "",
        *_table(record),
        "",
        "*Confident half*: the half of each image's pixels with the highest confidence. *Median*: "
        "a constant depth that knows each image's median. *5 views (3 of the same)*: those with "
        "five photos, in brackets three of the same; - where none has. icl_livingroom5_synthetic, "
        "nyu_dining5 and every second tuple of livingroom1_synthetic helped to choose between sets "
        "of weights; the other three are the fairer test. Written by `benchmarks/real.py`.",
        "",
        "The paper's methods side by side are in [tables](tables.md), what became of its claims "
        "in [claims](claims.md).",
    ]
    if refined is not None:
        lines += [
            "",
            "## With the cameras corrected by the photos",
            "",
            f"The same with `--poses refined` (weights {refined['weights_hash']}, commit "
            f"{refined['commit']}, {refined['date']}): poses that the photos correct, as `mvsam "
            "predict` does it, without any depth.",
            "",
            *_table(refined),
        ]
    if larger is not None:
        lines += [
            "",
            "## And in larger pictures",
            "",
            f"`{larger['command']}` (weights {larger['weights_hash']}, commit {larger['commit']}, "
            f"{larger['date']}): the later sweeps match at 480x384; scored at 320x256.",
            "",
            *_table(larger),
        ]
    if labels is not None:
        lines += ["", "## Labels on the held-out tenth of NYUv2's training images", ""]
        miou, right = (f"{100 * labels[key]:.1f} %" for key in ("miou", "accuracy"))
        lines.append(
            f"`{labels['model']}` (weights {labels['weights_hash']}), commit {labels['commit']}: "
            f"mIoU {miou}, {right} of the pixels right, {labels['num_images']} images, prompted "
            "with measured depth; by `benchmarks/nyu_labels.py`."
        )
    return "\n".join(lines) + "\n"


def _table(record: dict) -> list[str]:
    head = ["| " + " | ".join(COLUMNS) + " |", "|---|" + "---:|" * (len(COLUMNS) - 1)]
    return head + ["| " + " | ".join(row) + " |" for row in rows(record)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="folder of sequences")
    parser.add_argument("--model", default="tiny", help="name, weights file or hub id")
    parser.add_argument(
        "--poses", choices=("given", "refined"), default="given", help="as mvsam predict"
    )
    parser.add_argument("--size", type=int, nargs=2, help="for the network, as mvsam predict")
    parser.add_argument("--part", choices=("all", "choose", "report"), default="all")
    parser.add_argument("--tuples", type=int, help="of a sequence at most; the protocol's: 24")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    parser.add_argument("--page", type=Path, help="Markdown page to write")
    parser.add_argument("--refined", type=Path, help="record of --poses refined, for the page")
    parser.add_argument("--larger", type=Path, help="that with --size too, for the page")
    parser.add_argument("--labels", type=Path, help="what nyu_labels.py wrote, for the page")
    arguments = parser.parse_args()
    protocol, model = PROTOCOLS["real"], load(arguments.model).eval()
    if arguments.tuples:
        protocol = replace(protocol, tuples_per_scene=arguments.tuples)
    record = {
        "model": arguments.model,
        "weights_hash": model.weights_hash,
        "num_views": FEW,
        "part": arguments.part,
        "poses": arguments.poses,
        **provenance(),
        **measure(model, arguments.data, protocol, arguments.part, arguments.poses, arguments.size),
    }
    table = Table(*COLUMNS)
    for row in rows(record):
        table.add_row(*row)
    Console(width=120).print(table)
    if arguments.out:
        arguments.out.write_text(json.dumps(record, indent=2) + "\n")
    if arguments.page:
        labels, refined, larger = (
            json.loads(path.read_text()) if path else None
            for path in (arguments.labels, arguments.refined, arguments.larger)
        )
        arguments.page.write_text(page(record, labels, refined, larger))


if __name__ == "__main__":
    main()
