"""`mvsam bench`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mvsam.commands.shared import Json, print_json, print_table, progress_bar

if TYPE_CHECKING:
    from mvsam.apps.bench import Measurement


@dataclass(frozen=True)
class Bench:
    """Seconds for each box of the network, and peak memory, on this machine.

    Weights are random: speed does not depend on them. Every case has a process of its own.
    "all" is every view as reference in turn, with features computed once.

    Example: mvsam bench --models tiny cas_mvsnet --views 3
    """

    models: tuple[str, ...] = ("tiny", "cas_mvsnet", "base")
    """Names of mvsam models."""
    precisions: tuple[str, ...] = ("float32", "bfloat16")
    """float32, bfloat16."""
    views: int = 3
    """Photos of a tuple."""
    width: int = 320
    """Pixels."""
    height: int = 256
    """Pixels."""
    repeats: int = 3
    """The median of so many runs counts."""
    out: Path | None = None
    """A JSON file to keep the figures in."""
    json: Json = False

    def run(self) -> None:
        from mvsam.apps.bench import Case, machine_record, run_case
        from mvsam.build import model_spec
        from mvsam.errors import InputError
        from mvsam.files import write_json

        for model in self.models:
            model_spec(model)  # names are checked before minutes are spent
        if unknown := set(self.precisions) - {"float32", "bfloat16"}:
            raise InputError(f"--precisions {unknown.pop()}: choose float32 or bfloat16.")
        size = (self.views, self.width, self.height, self.repeats)
        cases = [Case(m, p, *size) for m in self.models for p in self.precisions]
        measured = []
        with progress_bar() as progress:
            for case in progress.track(cases, description="bench"):
                measured.append(run_case(case))
        report = {**machine_record(), "cases": [asdict(m) for m in measured]}
        if self.out:
            write_json(self.out, report)
        if self.json:
            print_json(report)
        else:
            _print_measurements(measured)


def _print_measurements(measured: list[Measurement]) -> None:
    from rich.table import Table

    from mvsam.apps.bench import BOXES

    table = Table("model", "precision", title="seconds")
    for title in (*BOXES, "one", "all", "all / one", "peak MiB", "of it libraries"):
        table.add_column(title.replace("_encoder", "").replace("_", " "), justify="right")
    for m in measured:
        boxes = [f"{m.stages[box]:.3f}" if box in m.stages else "-" for box in BOXES]
        table.add_row(
            m.case.model,
            m.case.precision,
            *boxes,
            f"{m.seconds:.2f}",
            f"{m.seconds_all_references:.2f}",
            f"{m.seconds_all_references / m.seconds:.2f}",
            f"{m.peak_mib:.0f}",
            f"{m.libraries_mib:.0f}",
        )
    print_table(table)
