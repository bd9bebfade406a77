"""Validation curves of training runs, from their logs: a JSON file and a picture.

    python benchmarks/curve.py runs/tiny_semantic_full runs/tiny_joint \
        --out results/tiny_curve.json --picture docs/pictures/tiny_curve.png

Hours are those of the clock while the run was going; time between a stop and the resumed run, and
between runs, is left out.
"""

import argparse
from itertools import pairwise
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from mvsam.files import write_json
from mvsam.provenance import provenance

SCORES = ("val/rel", "val/miou")
LONGEST_STEP_SECONDS = 120
"""A longer silence between two entries of the log is a stop, not work."""


def curve(folder: Path) -> list[dict]:
    """One entry a validation: step, hours since the run's start, scores as fractions."""
    log = EventAccumulator(str(folder))
    log.Reload()
    events = {tag: log.Scalars(tag) for tag in log.Tags()["scalars"]}
    beats = sorted({event.wall_time for series in events.values() for event in series})
    worked, hours = {beats[0]: 0.0}, 0.0
    for before, now in pairwise(beats):
        hours += min(now - before, LONGEST_STEP_SECONDS) / 3600
        worked[now] = hours
    points: dict[int, dict] = {}
    for tag in SCORES:
        for event in events.get(tag, []):
            point = points.setdefault(
                event.step, {"step": event.step + 1, "hours": worked[event.wall_time]}
            )
            point[tag.removeprefix("val/")] = event.value
    return [points[step] for step in sorted(points)]


def draw(curves: dict[str, list[dict]], path: Path) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    for axis, key, title in zip(axes, ("rel", "miou"), ("Rel, %", "mIoU, %"), strict=True):
        begin = 0.0
        for name, points in curves.items():
            chosen = [p for p in points if key in p]
            hours = [begin + p["hours"] for p in chosen]
            axis.plot(hours, [100 * p[key] for p in chosen], "o-", markersize=3, label=name)
            begin += points[-1]["hours"] if points else 0.0
        axis.set_xlabel("hours of training")
        axis.set_title(title)
        axis.grid(alpha=0.3)
    axes[1].legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("runs", nargs="+", type=Path, help="folders of runs, in their order")
    parser.add_argument("--out", type=Path, required=True, help="JSON file to write")
    parser.add_argument("--picture", type=Path, help="picture to draw")
    arguments = parser.parse_args()
    curves = {folder.name: curve(folder) for folder in arguments.runs}
    write_json(arguments.out, {**provenance(), "curves": curves})
    if arguments.picture:
        draw(curves, arguments.picture)


if __name__ == "__main__":
    main()
