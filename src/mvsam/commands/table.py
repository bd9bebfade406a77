"""`mvsam table`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mvsam.commands.shared import Json, print_json
from mvsam.errors import InputError, MissingExtraError

if TYPE_CHECKING:
    from mvsam.experiments.row_training import Folders


@dataclass(frozen=True)
class Table:
    """One of the paper's tables: what it published beside what was measured here.

    With --train the rows that are not measured yet are trained and scored first, each in
    runs/RUN-SEED with its result in results/runs; stopped, the same command goes on, and a second
    process started beside it takes other rows. Table 6 is a picture of depth maps.

    Example: mvsam table 1 --data rooms --train --rows cas_mvsnet
    """

    number: Annotated[tyro.conf.Positional[Literal[1, 2, 3, 4, 5, 6]], tyro.conf.arg(metavar="N")]
    """1 to 6."""
    data: Literal["rooms", "scannet"] = "rooms"
    """rooms: every row small, on procedural rooms; scannet: the paper's sizes and settings."""
    train: bool = False
    """Train and score what is missing before the table is shown."""
    rows: tuple[str, ...] = ()
    """Train these rows alone; names of the table's first column."""
    steps: int | None = None
    """Steps of every row that is trained, as on a GPU; each row's own where it is not given."""
    seeds: int | None = None
    """Seeds of every row that is trained; each row's own number where it is not given."""
    accelerator: Literal["auto", "cpu", "gpu"] = "auto"
    """What to train on; auto takes a GPU where there is one."""
    results: Path = Path("results")
    """Folder with runs/RUN-SEED.json and speed.json."""
    figure: Path | None = None
    """Draw it into this file: bars, for Table 6 depth maps (there table6.png by default)."""
    markdown: bool = False
    """Print Markdown."""
    csv: bool = False
    """Print comma-separated values: metres, fractions, seconds."""
    json: Json = False

    def run(self) -> None:
        if self.markdown + self.csv + self.json > 1:
            raise InputError("a table has one form: give one of --markdown, --csv and --json.")
        try:
            from mvsam.experiments.row_training import Folders
        except ModuleNotFoundError as error:
            raise MissingExtraError("tables", error.name or "lightning", "train") from error
        folders = Folders(results=self.results / "runs")
        if self.train:
            self._train(folders)
        else:
            self._check_shown_only()
        if self.number == 6:
            self._show_pictures(folders)
        else:
            self._show()

    def _check_shown_only(self) -> None:
        """InputError for options that would be passed over in silence."""
        numbers = (self.steps, self.seeds)
        if self.rows or numbers != (None, None) or self.accelerator != "auto":
            raise InputError(
                "--rows, --steps, --seeds and --accelerator say how to train: add --train."
            )
        if self.results != Path("results") and not self.results.is_dir():
            raise InputError(f"{self.results}: no such folder, so nothing is measured there.")

    def _train(self, folders: Folders) -> None:
        from mvsam.experiments.row_training import jobs_of, train_jobs
        from mvsam.experiments.runs import BUDGETS
        from mvsam.experiments.tables import runs_of

        rows = runs_of(self.number)
        if unknown := sorted(set(self.rows) - set(rows)):
            raise InputError(
                f"Table {self.number} has no row {', '.join(unknown)}; rows: {', '.join(rows)}."
            )
        if any(number is not None and number < 1 for number in (self.steps, self.seeds)):
            raise InputError("--steps and --seeds must be 1 or more.")
        chosen = [row for row in rows if not self.rows or row in self.rows]
        jobs = jobs_of(
            chosen,
            BUDGETS[self.data],
            self.steps,
            self.seeds or (1 if self.number == 6 else None),  # whose pictures it shows
            self.accelerator,
            needs_weights=self.number == 6,
        )
        elsewhere = train_jobs(jobs, folders, _announce, _show_scoring)
        if elsewhere:
            _announce(f"trainings left to others: {len(elsewhere)}; call again when they ended")

    def _show(self) -> None:
        from mvsam.apps.tables.contents import lines_of
        from mvsam.apps.tables.figure import draw_bars
        from mvsam.apps.tables.render import as_csv, as_json, as_markdown, print_text
        from mvsam.experiments.tables import TABLES

        table = TABLES[self.number]
        lines = lines_of(table, self.data, self.results)
        if self.figure:
            draw_bars(table, lines, self.figure)
        if self.json:
            print_json(as_json(table, self.data, lines))
        elif self.csv:
            print(as_csv(table, lines), end="")
        elif self.markdown:
            print(as_markdown(table, self.data, lines), end="")
        else:
            print_text(table, self.data, lines)

    def _show_pictures(self, folders: Folders) -> None:
        from mvsam.apps.tables.grid import collect, draw_grid

        if self.markdown or self.csv or self.json:
            raise InputError("Table 6 is a picture: leave --markdown, --csv and --json out.")
        path = self.figure or Path("table6.png")
        draw_grid(collect(self.data, folders), path)
        print(path)


def _announce(sentence: str) -> None:
    print(f"row {sentence}", file=sys.stderr)


def _show_scoring(done: int, count: int) -> None:
    """A line every fifty photos: a bar would fight with the trainer's."""
    if done % 50 == 0 or done == count:
        print(f"  scored {done} of {count}", file=sys.stderr)
