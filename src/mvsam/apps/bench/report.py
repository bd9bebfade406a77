"""Measurements as ratios and as tables for the terminal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from rich.table import Table

from mvsam.apps.bench.cases import Case, Work
from mvsam.apps.bench.measure import REGULARIZERS, Measurement

COLUMNS: dict[Work, dict[str, str]] = {
    "predict": {
        "semantic_encoder": "SAM",
        "geometry_encoder": "pyramid",
        "bridge": "bridge",
        "cascade": "cascade",
        "regularizers": "its 3D nets",
        "decoder": "decoder",
    },
    "train": {"forward": "forward", "backward": "backward", "optimizer": "optimizer"},
}
"""Stage -> title, for each table."""


@dataclass(frozen=True)
class Ratio:
    """How many times as much a textbook form takes as ours."""

    case: Case
    """Ours."""
    against: str
    """Precision of the textbook form."""
    seconds: float
    seconds_all_references: float
    stages: dict[str, float]
    working_memory: float
    working_memory_all_references: float


def ratios(measured: Sequence[Measurement]) -> list[Ratio]:
    """Ours against the textbook form in the same precision, and in float32 if that is another."""
    by_case = {m.case: m for m in measured}
    found = []
    for ours in measured:
        for precision in dict.fromkeys((ours.case.precision, "float32")):
            textbook = by_case.get(replace(ours.case, form="textbook", precision=precision))
            if ours.case.form == "ours" and textbook is not None:
                found.append(_ratio(ours, textbook))
    return found


def _ratio(ours: Measurement, textbook: Measurement) -> Ratio:
    mine, theirs = with_regularizers(ours.stages), with_regularizers(textbook.stages)
    return Ratio(
        case=ours.case,
        against=textbook.case.precision,
        seconds=textbook.seconds / ours.seconds,
        seconds_all_references=textbook.seconds_all_references / ours.seconds_all_references,
        stages={stage: theirs[stage] / mine[stage] for stage in mine if stage in theirs},
        working_memory=textbook.working_mib / ours.working_mib,
        working_memory_all_references=textbook.working_mib_all_references
        / ours.working_mib_all_references,
    )


def with_regularizers(stages: Mapping[str, float]) -> dict[str, float]:
    """The stages, and `regularizers` for the 3D networks of a cascade together."""
    together = [stages[name] for name in REGULARIZERS if name in stages]
    return {**stages, **({"regularizers": sum(together)} if together else {})}


def tables(measured: Sequence[Measurement]) -> list[Table]:
    """One for predictions and one for training steps, those that were measured."""
    works = dict.fromkeys(m.case.work for m in measured)
    return [_table(work, [m for m in measured if m.case.work == work]) for work in works]


def _table(work: Work, measured: Sequence[Measurement]) -> Table:
    title = {"predict": "predict: seconds", "train": "training step: seconds"}[work]
    table = Table("model", "precision", "form", title=title)
    for column in (*COLUMNS[work].values(), "one ref.", "all ref.", "all / one", "MiB", "MiB all"):
        table.add_column(column, justify="right")
    found = ratios(measured)
    for m in measured:
        stages = with_regularizers(m.stages)
        row = [*_stage_cells(work, stages, "{:.3f}"), f"{m.seconds:.2f}"]
        row += [f"{m.seconds_all_references:.2f}", f"{m.seconds_all_references / m.seconds:.2f}"]
        row += [f"{m.working_mib:.0f}", f"{m.working_mib_all_references:.0f}"]
        table.add_row(m.case.model, m.case.precision, m.case.form, *row)
        for ratio in found:
            if ratio.case == m.case:
                table.add_row(*_ratio_cells(work, ratio), style="bold")
    return table


def _ratio_cells(work: Work, ratio: Ratio) -> list[str]:
    values = (ratio.seconds, ratio.seconds_all_references)
    memory = (ratio.working_memory, ratio.working_memory_all_references)
    return [
        *("", "", f"against {ratio.against}"),
        *_stage_cells(work, ratio.stages, "{:.1f}x"),
        *(f"{value:.1f}x" for value in values),
        "",
        *(f"{value:.1f}x" for value in memory),
    ]


def _stage_cells(work: Work, stages: Mapping[str, float], template: str) -> list[str]:
    return [template.format(stages[name]) if name in stages else "-" for name in COLUMNS[work]]
