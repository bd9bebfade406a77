"""A table as bars: published beside measured, with the deviation over the seeds."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mvsam.apps.tables.contents import Line, title_of
from mvsam.apps.tables.render import TITLES
from mvsam.errors import InputError, MissingExtraError
from mvsam.experiments.tables import Table
from mvsam.files import write_whole

PUBLISHED, MEASURED = "#b8b8b8", "#2f6fb0"


def pyplot() -> Any:
    """matplotlib's, drawing to files; MissingExtraError without it."""
    try:
        import matplotlib
    except ModuleNotFoundError as error:
        raise MissingExtraError("a figure", "matplotlib", "figures") from error
    matplotlib.use("Agg")
    from matplotlib import pyplot

    return pyplot


def draw_bars(table: Table, lines: Sequence[Line], path: Path) -> None:
    """One panel a metric, one pair of bars a row; hatched: too few pictures, no claim."""
    plt = pyplot()
    height = 1.2 + 0.42 * len(lines)
    width = 2.2 + 3.2 * len(table.metrics)
    figure, axes = plt.subplots(
        1, len(table.metrics), figsize=(width, height), sharey=True, layout="constrained"
    )
    for axis, metric in zip(
        [axes] if len(table.metrics) == 1 else axes, table.metrics, strict=True
    ):
        _panel(axis, metric, lines)
    figure.suptitle(title_of(table), fontsize=10)
    legend = "bars: mean and deviation over seeds; hatched: too few pictures, no claim"
    figure.supxlabel(legend, fontsize=7)
    save(figure, path)
    plt.close(figure)


def _panel(axis: Any, metric: str, lines: Sequence[Line]) -> None:
    labels = [f"{line.row.method} ({line.row.views})" for line in lines]
    for place, line in enumerate(lines):
        published = line.row.published.get(metric)
        if published is not None:
            axis.barh(place - 0.2, 100 * published, 0.36, color=PUBLISHED)
        measured = line.measured.means[metric] if line.measured else None
        if line.measured is not None and measured is not None:
            deviation = line.measured.deviations[metric]
            axis.barh(
                place + 0.2,
                100 * measured,
                0.36,
                xerr=None if deviation is None else 100 * deviation,
                color=MEASURED if line.has_full_budget else "none",
                edgecolor=MEASURED,
                hatch=None if line.has_full_budget else "////",
                capsize=3,
            )
        elif published is not None:
            axis.text(0, place + 0.2, " missing", va="center", fontsize=7, color=MEASURED)
    axis.set_yticks(range(len(lines)), labels, fontsize=8)
    if not axis.yaxis_inverted():
        axis.invert_yaxis()
    axis.set_title(f"{TITLES[metric]}: published grey, measured blue", fontsize=8)
    axis.grid(axis="x", alpha=0.3)


def save(figure: Any, path: Path) -> None:
    """The whole picture or none; InputError for an ending that says no format."""
    known = figure.canvas.get_supported_filetypes()
    form = path.suffix.removeprefix(".").lower()
    if form not in known:
        raise InputError(f"--figure {path} must end in one of: {', '.join(sorted(known))}.")
    write_whole(path, lambda file: figure.savefig(file, format=form, dpi=110))
