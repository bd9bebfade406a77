"""`mvsam bench`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from mvsam.commands.shared import Device, Json, print_json, print_table, progress_bar

if TYPE_CHECKING:
    from mvsam.apps.bench.cases import Case


@dataclass(frozen=True)
class Bench:
    """Seconds for each box of the network, and memory, beside the textbook forms of the same.

    Textbook is how published code runs the same weights: every view warped into a volume of its
    own, default layout, batch norm as a layer, every reference encoding all views anew. Rows
    "against" say how many times as much it takes. "MiB" is the peak beyond libraries and weights;
    a training step is forward, backward and AdamW on one sample. Weights are random: speed does
    not depend on them. Every case has a process of its own.

    Example: mvsam bench --models tiny cas_mvsnet --views 3
    """

    models: tuple[str, ...] = ("tiny", "cas_mvsnet")
    """Names of mvsam models."""
    work: tuple[Literal["predict", "train"], ...] = ("predict", "train")
    """Predictions, training steps."""
    forms: tuple[Literal["ours", "textbook"], ...] = ("ours", "textbook")
    """As the product runs, as published code runs."""
    precisions: tuple[Literal["auto", "float32", "bfloat16"], ...] = ("float32", "auto")
    """auto: bfloat16 where the device multiplies it natively, else float32."""
    views: int = 3
    """Photos of a tuple."""
    width: int = 320
    """Pixels."""
    height: int = 256
    """Pixels."""
    references: tuple[Literal["one", "all"], ...] = ("one", "all")
    """The first photo as reference, every photo in turn."""
    repeats: int = 3
    """The median of so many runs counts."""
    device: Device = "auto"
    """auto: a GPU where there is one."""
    out: Path | None = None
    """A JSON file to keep the figures in, those measured so far if it is stopped."""
    json: Json = False

    def run(self) -> None:
        from mvsam.apps.bench.cases import check_case
        from mvsam.apps.bench.machine import machine_record
        from mvsam.apps.bench.measure import run_case
        from mvsam.apps.bench.report import ratios, tables
        from mvsam.errors import InputError
        from mvsam.files import write_json

        cases = self.cases()
        if not cases:
            raise InputError(
                "textbook training in bfloat16 is unsound on a CPU: choose other --precisions."
            )
        for case in cases:
            check_case(case)
        machine, measured, report = machine_record(cases[0].device), [], {}
        with progress_bar() as progress:
            for case in progress.track(cases, description="bench"):
                measured.append(run_case(case))
                report = {
                    **machine,
                    "cases": [asdict(m) for m in measured],
                    "ratios": [asdict(ratio) for ratio in ratios(measured)],
                }
                if self.out:  # after every case: a long bench may be stopped
                    write_json(self.out, report)
        if self.json:
            print_json(report)
        else:
            for table in tables(measured):
                print_table(table)

    def cases(self) -> list[Case]:
        """Every combination of the options that is sound, each once."""
        from mvsam.apps.bench.cases import Case, is_sound, most_references
        from mvsam.device import find_device
        from mvsam.precision import resolve

        device = find_device(self.device)
        combinations = product(self.work, self.models, self.precisions, self.references, self.forms)
        cases = [
            Case(
                model,
                form,
                work,
                resolve(precision, device),
                self.views,
                most_references(model, self.views) if references == "all" else 1,
                self.width,
                self.height,
                repeats=self.repeats,
                device=device,
            )
            for work, model, precision, references, form in combinations
        ]
        return [case for case in dict.fromkeys(cases) if is_sound(case)]
