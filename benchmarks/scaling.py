"""Seconds and memory of predictions as views, planes and pictures grow: a JSON file and a picture.

    python benchmarks/scaling.py --out results/scaling.json --picture docs/pictures/scaling.png
    python benchmarks/scaling.py --redraw results/scaling.json --picture docs/pictures/scaling.png

`cas_mvsnet` and `tiny`, and the textbook form of the former, in the precision the device is best
at; and the largest case a robot should take, 8 views of 640x512.
"""

import argparse
import json
from dataclasses import asdict, replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import torch
from rich.progress import track

from mvsam.apps.bench.cases import Case
from mvsam.apps.bench.machine import machine_record
from mvsam.apps.bench.measure import Measurement, run_case
from mvsam.apps.bench.scaling import cases_along, fit_line
from mvsam.files import write_json
from mvsam.precision import resolve

QUANTITIES = {"seconds": "seconds", "working_mib": "MiB beyond\nlibraries and weights"}
AXES = {
    "views": "views",
    "planes": "planes of the coarsest stage",
    "megapixels": "megapixels of a picture",
}


def measure(repeats: int) -> dict:
    """Every case in a process of its own, each once."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    ours = Case("cas_mvsnet", precision=resolve("auto", device), repeats=repeats, device=device)
    bases = (ours, replace(ours, model="tiny"), replace(ours, form="textbook"))
    lines = [(base, axis, points) for base in bases for axis, points in cases_along(base).items()]
    largest = [replace(base, num_views=8, width=640, height=512) for base in bases[:2]]
    cases = dict.fromkeys([case for _, _, points in lines for _, case in points] + largest)
    measured = {case: run_case(case) for case in track(list(cases), description="scaling")}
    return {
        **machine_record(device),
        "precision": ours.precision,
        "series": [
            series(base, axis, [place for place, _ in points], [measured[c] for _, c in points])
            for base, axis, points in lines
        ],
        "largest": [asdict(measured[case]) for case in largest],
    }


def series(base: Case, axis: str, places: list[float], points: list[Measurement]) -> dict:
    """One model along one axis, with the straight line through each quantity."""
    found: dict = {"model": base.model, "form": base.form, "axis": axis, "places": places}
    for quantity in QUANTITIES:
        values = [getattr(point, quantity) for point in points]
        found[quantity] = {"values": values, "line": asdict(fit_line(places, values))}
    return found


def draw(record: dict, path: Path) -> None:
    figure, grid = plt.subplots(2, 3, figsize=(10, 5.5), layout="constrained")
    for row, (quantity, quantity_title) in zip(grid, QUANTITIES.items(), strict=True):
        for axes, (axis, title) in zip(row, AXES.items(), strict=True):
            for index, found in enumerate(s for s in record["series"] if s["axis"] == axis):
                places, line = found["places"], found[quantity]["line"]
                ends = [0, max(places)]
                fitted = [line["intercept"] + line["slope"] * place for place in ends]
                axes.plot(ends, fitted, color=f"C{index}", linewidth=0.8, alpha=0.6)
                label = " ".join([found["model"]] + ["textbook"] * (found["form"] == "textbook"))
                axes.plot(places, found[quantity]["values"], "o", color=f"C{index}", label=label)
            axes.set_xlim(left=0)
            axes.set_ylim(bottom=0)
            axes.set_xlabel(title)
            axes.grid(alpha=0.3)
        row[0].set_ylabel(quantity_title)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    figure.suptitle(
        f"{record['device']}, {record['threads']} threads, {record['precision']}", fontsize=9
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--out", type=Path, help="JSON file to write")
    source.add_argument("--redraw", type=Path, help="JSON file to draw without measuring")
    parser.add_argument("--picture", type=Path, help="picture to draw")
    parser.add_argument("--repeats", type=int, default=2, help="the median of so many runs counts")
    arguments = parser.parse_args()
    if arguments.out:
        write_json(arguments.out, measure(arguments.repeats))
    record = json.loads((arguments.out or arguments.redraw).read_text())
    if arguments.picture:
        draw(record, arguments.picture)
    for found in record["series"]:
        deviations = [found[quantity]["line"]["largest_deviation"] for quantity in QUANTITIES]
        print(
            f"{found['model']} {found['form']} by {found['axis']}: off the straight line by at "
            f"most {deviations[0]:.1%} in seconds, {deviations[1]:.1%} in memory"
        )


if __name__ == "__main__":
    main()
