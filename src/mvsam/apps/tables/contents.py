"""What stands in a table: for each row the published, the measured, and what either rests on."""

import json
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


def _line(row: TableRow, run: RowRun, results: Path, speeds: dict[str, Speed]) -> Line:
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
        speeds.get(speed_key(model, run.experiment.data.num_views)),
    )


def speed_key(model: str, num_views: int) -> str:
    return f"{model} {num_views}"


def read_speeds(path: Path) -> dict[str, Speed]:
    """By `speed_key`; empty where nothing was measured."""
    if not path.exists():
        return {}
    try:
        content: dict[str, Any] = json.loads(path.read_text())
        return {
            speed_key(one["model"], one["views"]): Speed(
                one["seconds"], one["working_mib"] + one["weights_mib"], one["device"]
            )
            for one in content["methods"]
        }
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path} holds no speeds ({type(error).__name__}: {error}); remove it and run "
            "`python benchmarks/methods.py` again."
        ) from error


def heading(table: Table, budget: Budget, lines: list[Line]) -> list[str]:
    """What the figures are, in sentences: title, data and protocol, remarks."""
    run = lines[0].run
    short = [line for line in lines if line.measured and not line.has_full_budget]
    sentences = [
        f"Table {table.number}: {table.title}",
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
            "step, after which losses still fall. Rows with SAM begin with the encoder of `tiny`, "
            "which has learned depth and these classes from other rooms."
        )
    device = next((line.speed.device for line in lines if line.speed), None)
    if device is not None:
        sentences.append(
            "s, MiB: one prediction at 320x256 with as many views as the row has, weights "
            f"included; random weights, {device}, benchmarks/methods.py."
        )
    if table.note:
        sentences.append(table.note)
    if short:
        sentences.append(
            "Rows that are not converged had too few pictures; they show that the method runs, "
            "and nothing is to be concluded from their scores."
        )
    return sentences
