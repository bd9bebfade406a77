"""Measurements as ratios and as tables for the terminal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from rich.table import Table

from mvsam.apps.bench.cases import Case, Work
from mvsam.apps.bench.measure import REGULARIZERS, Measurement

TITLES: dict[Work, str] = {"predict": "predict, seconds", "train": "training step, seconds"}
STAGES: dict[Work, dict[str, str]] = {
    "predict": {
        "semantic_encoder": "SAM",
        "geometry_encoder": "pyramid",
        "bridge": "bridge",
        "prior": "prior",
        "cascade": "cascade",
        "regularizers": "its 3D nets",
        "context": "context",
        "decoder": "decoder",
    },
    "train": {"forward": "forward", "backward": "backward", "optimizer": "optimizer"},
}
"""Stage -> title of its column."""


@dataclass(frozen=True)
class Ratio:
    """How many times as much the textbook form takes as ours."""

    case: Case
    """Ours."""
    against: str
    """Precision of the textbook form."""
    seconds: float
    stages: dict[str, float]
    working_memory: float


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
        stages={stage: theirs[stage] / mine[stage] for stage in mine if stage in theirs},
        working_memory=textbook.working_mib / ours.working_mib,
    )


def with_regularizers(stages: Mapping[str, float]) -> dict[str, float]:
    """The stages, and `regularizers` for the 3D networks of a cascade together."""
    together = [stages[name] for name in REGULARIZERS if name in stages]
    return {**stages, **({"regularizers": sum(together)} if together else {})}


def tables(measured: Sequence[Measurement]) -> list[Table]:
    """One for predictions and one for training steps, those that were measured.

    "of one": seconds beside those of one reference.
    """
    works: dict[Work, None] = dict.fromkeys(m.case.work for m in measured)
    return [_table(work, [m for m in measured if m.case.work == work]) for work in works]


def _table(work: Work, measured: Sequence[Measurement]) -> Table:
    table = Table("model", "precision", "form", title=TITLES[work])
    for title in ("references", *STAGES[work].values(), "together", "of one", "MiB"):
        table.add_column(title, justify="right")
    found, by_case = ratios(measured), {m.case: m for m in measured}
    for m in measured:
        named = (m.case.model, m.case.precision, m.case.form, str(m.case.num_references))
        cells = _stage_cells(work, with_regularizers(m.stages), "{:.3f}")
        one = by_case.get(replace(m.case, num_references=1), m)
        cells += [f"{m.seconds:.3f}", f"{m.seconds / one.seconds:.2f}x", f"{m.working_mib:.0f}"]
        table.add_row(*named, *cells)
        for ratio in found:
            if ratio.case == m.case:
                cells = _stage_cells(work, ratio.stages, "{:.1f}x")
                cells += [f"{ratio.seconds:.1f}x", "", f"{ratio.working_memory:.1f}x"]
                table.add_row("", "", f"against {ratio.against}", "", *cells, style="bold")
    return table


def _stage_cells(work: Work, stages: Mapping[str, float], template: str) -> list[str]:
    return [template.format(stages[name]) if name in stages else "-" for name in STAGES[work]]
