"""A table as text for the terminal, as Markdown, as CSV and as JSON."""

import csv
import io
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table as TextTable

from mvsam.apps.tables.contents import Line, remarks_of_all, remarks_of_one, title_of
from mvsam.experiments.rows import Budget
from mvsam.experiments.tables import Table

TITLES = {"abs": "Abs cm", "rel": "Rel %", "rmse": "RMSE cm", "miou": "mIoU %"}
NOTHING = "-"
WIDE, NARROW = 230, 150
"""Characters that the widest table needs, with all columns and without details."""


@dataclass(frozen=True)
class Column:
    """A column for people."""

    title: str
    cell: Callable[[Line], str]
    is_text: bool = False
    may_wrap: bool = False
    is_detail: bool = False
    """Left out on a terminal that is not wide enough."""


def columns_of(table: Table) -> list[Column]:
    """Published beside measured for every metric, then what the figures rest on."""
    scores = [column for metric in table.metrics for column in _scores(metric)]
    return [
        Column("row", lambda line: line.row.run, is_text=True),
        Column("method", lambda line: line.row.method, is_text=True, is_detail=True),
        Column("input", lambda line: line.row.modality, is_text=True, is_detail=True),
        Column("views", lambda line: str(line.row.views)),
        *scores,
        Column("steps", lambda line: f"{line.measured.steps:,}" if line.measured else NOTHING),
        Column("seeds", _seeds),
        Column("begins with", _weights, is_text=True, may_wrap=True, is_detail=True),
        Column("parameters", _parameters, is_detail=True),
        Column("s", _seconds, is_detail=True),
        Column("MiB", _mib, is_detail=True),
        Column("state", lambda line: line.state, is_text=True, may_wrap=True),
    ]


def _scores(metric: str) -> tuple[Column, Column]:
    def published(line: Line) -> str:
        value = line.row.published.get(metric)
        return NOTHING if value is None else f"{100 * value:.1f}"

    title = TITLES[metric]
    return (
        Column(f"{title} published", published),
        Column(f"{title} measured", lambda line: measured_text(line, metric)),
    )


def measured_text(line: Line, metric: str) -> str:
    """Mean and deviation in cm or percent; in brackets where it carries no claim."""
    value = line.measured.means[metric] if line.measured else None
    if line.measured is None or value is None:
        return NOTHING
    deviation = line.measured.deviations[metric]
    text = f"{100 * value:.1f}"
    if deviation is not None:
        text += f" +- {100 * deviation:.1f}"
    return text if line.has_full_budget else f"({text})"


def _seeds(line: Line) -> str:
    return " ".join(map(str, line.measured.seeds)) if line.measured else NOTHING


def _parameters(line: Line) -> str:
    return f"{line.parameters:,}" if line.parameters else NOTHING


def _seconds(line: Line) -> str:
    return f"{line.speed.seconds:.2f}" if line.speed else NOTHING


def _mib(line: Line) -> str:
    return f"{line.speed.mib:.0f}" if line.speed else NOTHING


def _weights(line: Line) -> str:
    if line.measured is None:
        return NOTHING
    return "from scratch" if line.measured.weights == "random" else line.measured.weights


def as_text(table: Table, budget: Budget, lines: list[Line], details: bool = True) -> TextTable:
    """For the terminal; remarks are its caption."""
    columns = [column for column in columns_of(table) if details or not column.is_detail]
    remarks = [*remarks_of_all(budget, lines), *remarks_of_one(table, lines)]
    if not details:
        remarks.append(
            f"Some columns are left out; {WIDE} characters, --markdown or --csv show all."
        )
    text = TextTable(title=title_of(table), caption="\n".join(remarks), caption_justify="left")
    for column in columns:
        title = column.title.replace(" published", "\npublished").replace(" measured", "\nmeasured")
        justify = "left" if column.is_text else "right"
        text.add_column(title, justify=justify, no_wrap=not column.may_wrap)
    for line in lines:
        text.add_row(*(column.cell(line) for column in columns))
    return text


def print_text(table: Table, budget: Budget, lines: list[Line]) -> None:
    """On stdout, without details where the terminal is narrow; no figure is cut."""
    # Without emoji: ":train:" in the name of the data would become a tram.
    console = Console(emoji=False, markup=False)
    is_narrow = sys.stdout.isatty() and console.width < WIDE
    console.width = max(console.width, NARROW if is_narrow else WIDE)
    console.print(as_text(table, budget, lines, details=not is_narrow))


def as_markdown(table: Table, budget: Budget, lines: list[Line]) -> str:
    """A table that stands alone."""
    return grid_of(table, lines) + "\n" + "\n\n".join(remarks_of_all(budget, lines)) + "\n"


def grid_of(table: Table, lines: list[Line]) -> str:
    """Title, grid and what must be known of this table, as Markdown."""
    columns = columns_of(table)
    rows = [
        [column.title for column in columns],
        ["---" if column.is_text else "--:" for column in columns],
        *([column.cell(line) for column in columns] for line in lines),
    ]
    grid = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    return "\n\n".join([f"**{title_of(table)}**", grid, *remarks_of_one(table, lines)]) + "\n"


def as_csv(table: Table, lines: Sequence[Line]) -> str:
    """One value a cell: metres, fractions, seconds; empty where there is none."""
    records = [_flat(line, table) for line in lines]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return text.getvalue()


def _flat(line: Line, table: Table) -> dict[str, Any]:
    record = _record(line, table)
    flat: dict[str, Any] = {}
    for name, value in record.items():
        if isinstance(value, dict):
            flat |= {f"{name}_{key}": each for key, each in value.items()}
        else:
            flat[name] = " ".join(map(str, value)) if isinstance(value, list) else value
    return flat


def as_json(table: Table, budget: Budget, lines: Sequence[Line]) -> dict[str, Any]:
    """Metres, fractions, seconds; null where there is none."""
    return {
        "table": table.number,
        "title": table.title,
        "budget": budget,
        "note": table.note,
        "rows": [_record(line, table) for line in lines],
    }


def _record(line: Line, table: Table) -> dict[str, Any]:
    measured, metrics = line.measured, table.metrics
    return {
        "method": line.row.method,
        "run": line.run.experiment.name,
        "model": line.run.experiment.model.name,
        "input": line.row.modality,
        "views": line.row.views,
        "published": {name: line.row.published.get(name) for name in metrics},
        "measured": {name: measured.means[name] if measured else None for name in metrics},
        "deviation": {name: measured.deviations[name] if measured else None for name in metrics},
        "data": line.run.scored_on,
        "protocol": line.run.protocol,
        "steps": measured.steps if measured else None,
        "pictures": measured.pictures if measured else None,
        "enough_pictures": line.run.enough,
        "seeds": list(measured.seeds) if measured else [],
        "weights": measured.weights if measured else None,
        "parameters": line.parameters,
        "seconds": line.speed.seconds if line.speed else None,
        "mib": line.speed.mib if line.speed else None,
        "speed_device": line.speed.device if line.speed else None,
        "speed_precision": line.speed.precision if line.speed else None,
        "state": line.state,
    }
