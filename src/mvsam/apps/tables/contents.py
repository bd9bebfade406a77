"""What stands in a table: for each row the published, the measured, and what either rests on."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mvsam.build import count_parameters
from mvsam.errors import InputError, MissingExtraError
from mvsam.experiments.results import Measured, read_measured
from mvsam.experiments.rows import Budget, RowRun
from mvsam.experiments.runs import BUDGETS
from mvsam.experiments.tables import Table, TableRow

SPEED_FILE = "speed.json"
"""In the folder of results, written by `benchmarks/methods.py`."""


@dataclass(frozen=True)
class Speed:
    """Of one prediction at 320x256."""

    seconds: float
    mib: float
    """Peak memory, weights included."""
    device: str
    precision: str


@dataclass(frozen=True)
class Line:
    """A row of a table, filled in."""

    row: TableRow
    run: RowRun
    measured: Measured | None
    parameters: int | None
    """Of the network that is trained under this budget; None where an extra is missing."""
    speed: Speed | None

    @property
    def has_full_budget(self) -> bool:
        """Whether it was trained for as long as a row that carries a claim."""
        return self.measured is not None and self.measured.pictures >= self.run.enough

    @property
    def state(self) -> str:
        """What may be concluded from the measured figures."""
        if self.measured is None:
            return "missing"
        if self.has_full_budget:
            return "full budget"
        seen = f"{self.measured.pictures:,} of {self.run.enough:,} pictures"
        return f"not converged, no claim ({seen})"


def lines_of(table: Table, budget: Budget, results: Path) -> list[Line]:
    """The rows of a table with what lies in the folder of results."""
    speeds = read_speeds(results / SPEED_FILE)
    return [_line(row, BUDGETS[budget][row.run], results, speeds) for row in table.rows]


def _line(row: TableRow, run: RowRun, results: Path, speeds: dict[tuple[str, int], Speed]) -> Line:
    model = run.experiment.model.name
    try:
        parameters = count_parameters(model)
    except MissingExtraError:
        parameters = None
    return Line(
        row,
        run,
        read_measured(results / "runs", run),
        parameters,
        speeds.get((model, run.experiment.data.num_views)),
    )


def read_speeds(path: Path) -> dict[tuple[str, int], Speed]:
    """By model and number of views; empty where nothing was measured."""
    if not path.exists():
        return {}
    try:
        content: dict[str, Any] = json.loads(path.read_text())
        return {
            (one["model"], one["views"]): Speed(
                one["seconds"],
                one["working_mib"] + one["weights_mib"],
                f"{one['device']}, {one['threads']} threads",
                one["precision"],
            )
            for one in content["methods"]
        }
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path} holds no speeds ({type(error).__name__}: {error}); remove it and run "
            "`python benchmarks/methods.py` again."
        ) from error


def title_of(table: Table) -> str:
    return f"Table {table.number}: {table.title}"


def remarks_of_all(budget: Budget, lines: Sequence[Line]) -> list[str]:
    """What the figures of any table are, in sentences: data, protocol, budget, speed."""
    run = lines[0].run
    sentences = [
        "Published: the paper, on ScanNet. Measured: mean and standard deviation over seeds on "
        f"{run.scored_on}, protocol {run.protocol}; trained on {run.experiment.data.train}.",
    ]
    if budget == "rooms":
        sentences.append(
            "Rooms are not ScanNet, networks with SAM or a cascade have the sizes of `tiny`: "
            "compare measured figures with each other, not with published ones."
        )
        sentences.append(
            f"Full budget: {run.enough:,} pictures, {run.experiment.train.batch_size} rooms a "
            "step, after which losses still fall. Rows with SAM begin with an encoder of `tiny`, "
            "which has learned depth and these classes from other rooms."
        )
    speed = next((line.speed for line in lines if line.speed), None)
    if speed is not None:
        sentences.append(
            "s, MiB: one prediction at 320x256 with as many views as the row has, weights "
            f"included; random weights, {speed.precision}, {speed.device}, benchmarks/methods.py."
        )
    return sentences


def remarks_of_one(table: Table, lines: Sequence[Line]) -> list[str]:
    """What must be known of this table beside."""
    sentences = [table.note] if table.note else []
    if any(line.measured and not line.has_full_budget for line in lines):
        sentences.append(
            "Rows that are not converged had too few pictures; they show that the method runs, "
            "and nothing is to be concluded from their scores."
        )
    return sentences
