"""The parts of the page as HTML; every text that comes from a file is escaped here."""

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import numpy as np
from jaxtyping import Int

from mvsam.data.labels import ClassTable
from mvsam.errors import counted
from mvsam.types import IGNORE

SCORES = {
    "abs": ("Abs cm", "mean error of the depth"),
    "rel": ("Rel %", "mean error, relative to the depth"),
    "rmse": ("RMSE cm", "root of the mean squared error"),
    "delta_1.03": ("<1.03 %", "of pixels within a factor of 1.03"),
    "delta_1.05": ("<1.05 %", "of pixels within a factor of 1.05"),
    "delta_1.25": ("<1.25 %", "of pixels within a factor of 1.25"),
    "miou": ("mIoU %", "mean overlap of the classes"),
    "ause": ("AUSE %", "how badly confidence sorts errors; 0 is best"),
}
"""Key in `metrics.json` -> title as in the terminal's table, and its meaning."""


def about(run: dict[str, Any], num_photos: int, date: str) -> str:
    """One line on what made the maps, one on how long that took; `run` may lack anything."""
    facts = [counted(num_photos, "photo"), f"report of {date}"]
    if "model" in run:
        facts.append(f"model {run['model']}, weights {run.get('weights_hash', 'unknown')}")
    versions = run.get("versions", {})
    facts.append(", ".join(f"{name} {version}" for name, version in versions.items()))
    facts.append(str(run.get("device", "")))
    paragraphs = [" · ".join(fact for fact in facts if fact)]
    if seconds := run.get("seconds"):
        stages = ", ".join(f"{stage} {value:.2f}" for stage, value in seconds.items())
        photos = counted(run.get("photos_predicted", num_photos), "photo")
        paragraphs.append(f"{sum(seconds.values()):.2f} s for {photos} in the last run: {stages}")
    return lines(f"<p>{escape(paragraph)}</p>" for paragraph in paragraphs)


def scores(metrics: dict[str, Any]) -> str:
    """Centimetres and percent, as the project's tables show them; an absent task is left out."""
    tiles = [
        f"<div><dt>{escape(title)}</dt><dd><strong>{100 * metrics[key]:.1f}</strong> "
        f"<small>{escape(meaning)}</small></dd></div>"
        for key, (title, meaning) in SCORES.items()
        if metrics.get(key) is not None
    ]
    about = f"protocol {metrics.get('protocol')}, {counted(metrics.get('num_images', 0), 'photo')}"
    return section(
        "Scores",
        f"<p>Against the scene's ground truth: {escape(about)}.</p>\n"
        f'<dl class="scores">\n{lines(tiles)}\n</dl>',
    )


def legend(
    counts: Int[np.ndarray, "256"],
    classes: ClassTable,
    class_iou: Sequence[float | None] | None,
    can_hide: bool,
) -> str:
    """The classes that occur, the largest first; with `can_hide` they are the viewer's buttons."""
    total = max(int(counts[:IGNORE].sum()), 1)
    rows = [
        _class_row(label, classes, int(counts[label]) / total, class_iou, can_hide)
        for label in np.argsort(-counts[:IGNORE], kind="stable").tolist()
        if counts[label]
    ]
    iou = "" if class_iou is None else '<th scope="col">IoU %</th>'
    return section(
        "Classes",
        f'{_HOW_TO_HIDE if can_hide else ""}<table class="legend">\n<thead><tr>'
        f'<th scope="col">class</th><th scope="col">pixels %</th>{iou}</tr></thead>\n'
        f"<tbody>\n{lines(rows)}\n</tbody>\n</table>",
    )


_HOW_TO_HIDE = """<div id="hiding">
<p>A click hides or shows a class in the 3D view; a double click, or one with shift, shows it
alone.</p>
<div class="tools"><button type="button" id="all-classes">Show all</button></div>
</div>
"""


def _class_row(
    label: int,
    classes: ClassTable,
    share: float,
    class_iou: Sequence[float | None] | None,
    can_hide: bool,
) -> str:
    is_named = label < len(classes)
    color = classes.colors[label] if is_named else (0, 0, 0)
    swatch = f'<span class="swatch" style="background: rgb{color}"></span>'
    name = swatch + escape(classes.names[label] if is_named else f"label {label}")
    if can_hide:
        name = f'<button type="button" data-label="{label}" aria-pressed="true">{name}</button>'
    iou = ""
    if class_iou is not None:
        value = class_iou[label] if label < len(class_iou) else None
        iou = "<td>-</td>" if value is None else f"<td>{100 * value:.1f}</td>"
    return f'<tr><th scope="row">{name}</th><td>{100 * share:.1f}</td>{iou}</tr>'


def colorings(has_labels: bool, has_confidence: bool) -> str:
    """The buttons of what the points may be coloured by; names as in `viewer.js`."""
    titles = {"photo": "Photo colours"}
    titles |= {"classes": "Classes"} if has_labels else {}
    titles |= {"confidence": "Confidence"} if has_confidence else {}
    return lines(
        f'<button type="button" data-coloring="{name}" '
        f'aria-pressed="{str(name == "photo").lower()}">{title}</button>'
        for name, title in titles.items()
    )


def no_cloud(reason: str) -> str:
    """Why there is none, in the words of `mvsam reconstruct`."""
    return f'<p class="note">There is no 3D view. mvsam reconstruct says: {escape(reason)}.</p>'


def photos(rows: Sequence[str], num_photos: int) -> str:
    """All rows under one another; says so where they are not of all photos."""
    note = f"{len(rows)} of {num_photos} photos, evenly spaced; the rest of the page is about all."
    notes = [f'<p class="note">{note}</p>'] if len(rows) < num_photos else []
    return section("Photos", lines([*notes, _COLORS_OF_DEPTH, *rows]))


_COLORS_OF_DEPTH = """<p>The colours of depth are each photo's own: red is the nearest of it, blue
the farthest, but for the outermost two percent of the pixels at both ends.</p>"""


def section(title: str, content: str) -> str:
    return f"<section>\n<h2>{title}</h2>\n{content}\n</section>"


def lines(parts: Iterable[str]) -> str:
    return "\n".join(parts)
