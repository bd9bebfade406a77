"""Seconds and memory of one prediction at 320x256 of every method of the tables.

    python benchmarks/methods.py --out results/speed.json
    python benchmarks/methods.py tiny cas_mvsnet --out results/speed.json

Weights are random: speed does not depend on them. Each method has a process of its own, is run as
the product runs it, and looks at as many views as in its row. What the file holds of other methods
on the same device stays, so that a long list can be measured piece by piece.
"""

import argparse
import json
from pathlib import Path

import torch

from mvsam.apps.bench.cases import Case, check_case
from mvsam.apps.bench.measure import run_case
from mvsam.device import find_device
from mvsam.experiments.runs import BUDGETS
from mvsam.files import write_json
from mvsam.precision import resolve
from mvsam.provenance import provenance

Method = tuple[str, int]
"""Model and number of views."""

VARIANTS: tuple[Method, ...] = (("mvs2d_multiscale", 3), ("emsaformer_mlp", 1))
"""Of methods of the tables, in no table themselves."""


def methods() -> list[Method]:
    """Of every row under both budgets, each once, and the variants."""
    rows = [run.experiment for runs in BUDGETS.values() for run in runs.values()]
    found = [(row.model.name, row.data.num_views) for row in rows]
    return list(dict.fromkeys([*found, *VARIANTS]))


def measured(model: str, num_views: int, device, repeats: int) -> dict:
    """One entry of the file."""
    precision = resolve("auto", device)
    case = Case(model, precision=precision, num_views=num_views, repeats=repeats, device=device)
    check_case(case)
    result = run_case(case)
    return {
        "model": model,
        "views": num_views,
        "size": [case.width, case.height],
        "precision": precision,
        "seconds": result.seconds,
        "working_mib": result.working_mib,
        "weights_mib": result.weights_mib,
        "ran_on": device,
        "threads": torch.get_num_threads(),
        **provenance(device),
    }


def merge(old: dict[Method, dict], new: dict) -> dict[Method, dict]:
    """The entries with one more; those of other devices go, as they cannot be compared."""
    place = ("device", "ran_on", "threads")
    kept = {k: entry for k, entry in old.items() if all(entry[p] == new[p] for p in place)}
    return kept | {(new["model"], new["views"]): new}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("models", nargs="*", help="names of mvsam models; none: all of the tables")
    parser.add_argument("--out", type=Path, required=True, help="JSON file to write")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--device", choices=("auto", "cpu", "cuda"), default="auto")
    arguments = parser.parse_args()
    device = find_device(arguments.device)
    entries: dict[Method, dict] = {}
    if arguments.out.exists():
        for entry in json.loads(arguments.out.read_text())["methods"]:
            entries[entry["model"], entry["views"]] = entry
    chosen = [pair for pair in methods() if not arguments.models or pair[0] in arguments.models]
    for model, num_views in chosen:
        entries = merge(entries, measured(model, num_views, device, arguments.repeats))
        write_json(arguments.out, {"methods": list(entries.values())})
        report(entries[model, num_views])


def report(entry: dict) -> None:
    mib = entry["working_mib"] + entry["weights_mib"]
    print(f"{entry['model']}, {entry['views']} views: {entry['seconds']:.3f} s, {mib:.0f} MiB")


if __name__ == "__main__":
    main()
