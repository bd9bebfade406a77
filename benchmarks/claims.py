"""The page of results: each claim of the paper beside what was measured, and Tables 1 to 5.

    python benchmarks/claims.py --data rooms --out docs/tables.md

What a claim that does not hold may be due to is for people to write; the page is made anew from the
files in results/runs every time.
"""

import argparse
from pathlib import Path

from mvsam.apps.tables.contents import lines_of, remarks_of_all
from mvsam.apps.tables.render import grid_of
from mvsam.experiments.claims import CLAIMS, Verdict, judge
from mvsam.experiments.runs import BUDGETS
from mvsam.experiments.tables import TABLES
from mvsam.files import write_whole
from mvsam.provenance import commit


def page(budget, results: Path) -> str:
    """Markdown."""
    verdicts = [judge(claim, BUDGETS[budget], results / "runs") for claim in CLAIMS]
    tables = [(table, lines_of(table, budget, results)) for table in TABLES.values()]
    remarks = remarks_of_all(budget, tables[0][1])
    grids = [grid_of(table, lines) for table, lines in tables]
    head = f"""# The tables of the paper

Made by `python benchmarks/claims.py --data {budget}` at commit {commit()}. How the rows are trained
is in [reproduce.md](reproduce.md#the-papers-tables).

## The paper's claims

Gain: difference of the means over seeds, +- the standard deviation of that difference between two
single runs. It counts from one such deviation on, which two equal rows of three seeds exceed by
chance once in six times; where a row has one seed, and is taken to scatter as the other does, from
two on.
What those that do not hold may be due to, and an experiment towards each: [claims](claims.md).
"""
    return "\n".join(
        [head, claims_table(verdicts), "## Tables\n", "\n\n".join(remarks), "", "\n".join(grids)]
    )


def claims_table(verdicts: list[Verdict]) -> str:
    rows = ["| claim | rows | published gain | measured gain | verdict |", "|---|---|--:|--:|---|"]
    for verdict in verdicts:
        claim = verdict.claim
        unit = "points of mIoU" if claim.metric == "miou" else "cm"
        cells = (
            claim.sentence,
            f"`{claim.better}`, `{claim.worse}`",
            f"{100 * verdict.published:.1f} {unit}",
            measured_cell(verdict),
            verdict.text,
        )
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows) + "\n"


def measured_cell(verdict: Verdict) -> str:
    if verdict.measured is None:
        return "-"
    text = f"{100 * verdict.measured:.1f}"
    return text if verdict.spread is None else f"{text} +- {100 * verdict.spread:.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--data", choices=tuple(BUDGETS), default="rooms")
    parser.add_argument("--results", type=Path, default=Path("results"))
    parser.add_argument("--out", type=Path, required=True, help="Markdown file to write")
    arguments = parser.parse_args()
    text = page(arguments.data, arguments.results)
    write_whole(arguments.out, lambda file: file.write(text.encode()))


if __name__ == "__main__":
    main()
