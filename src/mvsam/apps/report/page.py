"""Puts the page together: reads the folder, makes the parts, fills the template."""

import datetime
import json
from collections.abc import Callable, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from mvsam.apps.report import sections
from mvsam.apps.report.cloud_data import cloud_data
from mvsam.apps.report.photos import Photo, count_labels, read_labels
from mvsam.apps.report.rows import photo_row
from mvsam.apps.report.thumbnails import UNSURE_TO_SURE
from mvsam.data.labels import SCANNET20, ClassTable, read_class_table
from mvsam.data.sampling import evenly_spaced
from mvsam.errors import InputError
from mvsam.inference.pictures import NEAR_TO_FAR
from mvsam.reconstruction.cloud import NothingLeft, build_cloud
from mvsam.reconstruction.folder import read_predictions
from mvsam.reconstruction.settings import CloudSettings

MOST_ROWS = 60
"""Photos that are shown; scores, classes and the cloud are of all."""


def count_steps(photos: Sequence[Photo]) -> int:
    """How often `build_page` calls `on_step`."""
    return len(photos) + sum(photo.depth_path is not None for photo in photos)


def build_page(
    folder: Path,
    photos: Sequence[Photo],
    settings: CloudSettings,
    on_step: Callable[[], None] = lambda: None,
) -> str:
    """The page about a `predict` folder with these photos (`read_photos`).

    Raises `InputError` where a file of the folder is damaged.
    """
    run = _read_json(folder / "run.json") or {}
    metrics = _read_json(folder / "metrics.json")
    classes = _class_table(folder)
    cloud, has_viewer = _cloud(folder, photos, classes, settings, on_step)
    rows, counts = _rows(photos, classes, on_step)
    legend = ""
    if any(photo.label_path for photo in photos):
        legend = sections.legend(counts, classes, _class_iou(metrics, classes), has_viewer)
    name = str(run.get("scene") or folder.resolve().name)
    return _filled(
        "template.html",
        name=escape(name),
        about=sections.about(run, len(photos), datetime.date.today().isoformat()),
        cloud=cloud,
        legend=legend,
        scores=sections.scores(metrics) if metrics else "",
        photos=sections.photos(rows, len(photos)),
        style=_ramps() + _resource("style.css"),
        script=_resource("orbit.js") + _resource("viewer.js") if has_viewer else "",
    )


def _cloud(
    folder: Path,
    photos: Sequence[Photo],
    classes: ClassTable,
    settings: CloudSettings,
    on_step: Callable[[], None],
) -> tuple[str, bool]:
    """The section and whether it shows a cloud; it says why where no depth is to be trusted."""
    if not any(photo.depth_path for photo in photos):
        return "", False
    views = read_predictions(folder)
    try:
        cloud = build_cloud(views, settings, lambda name, share: on_step())
    except NothingLeft as nothing:
        return sections.section("Point cloud", sections.no_cloud(str(nothing))), False
    viewer = _filled(
        "viewer.html",
        buttons=sections.colorings(
            has_labels=any(view.label_path for view in views),
            has_confidence=any(view.confidence_path for view in views),
        ),
        data=json.dumps(cloud_data(cloud, settings.voxel_size, views, classes)),
    )
    return sections.section("Point cloud", viewer), True


def _rows(
    photos: Sequence[Photo], classes: ClassTable, on_step: Callable[[], None]
) -> tuple[list[str], np.ndarray]:
    """Those of the photos that are shown, and the pixels of every label in all photos."""
    shown = evenly_spaced(photos, MOST_ROWS)
    rows, counts = [], np.zeros(256, np.int64)
    for photo in photos:
        if photo.label_path is not None:
            counts += count_labels(read_labels(photo.label_path))
        if photo in shown:
            rows.append(photo_row(photo, classes))
        on_step()
    return rows, counts


def _class_table(folder: Path) -> ClassTable:
    """That of the maps; without labels there is none, and it is not shown."""
    path = folder / "classes.json"
    return read_class_table(path) if path.is_file() else SCANNET20


def _class_iou(
    metrics: dict[str, Any] | None, classes: ClassTable
) -> Sequence[float | None] | None:
    """The IoU of each class where there are true labels, of the same classes."""
    iou = (metrics or {}).get("iou") or []
    is_known = len(iou) == len(classes) and any(value is not None for value in iou)
    return iou if is_known else None


def _read_json(path: Path) -> dict[str, Any] | None:
    """None where there is no such file."""
    if not path.is_file():
        return None
    try:
        return dict(json.loads(path.read_text()))
    except (ValueError, TypeError) as error:
        raise InputError(f"{path} is damaged ({error}): run mvsam predict again") from error


def _ramps() -> str:
    """The colours of the maps' scales for the style sheet."""

    def gradient(colors: np.ndarray) -> str:
        stops = ", ".join(
            f"rgb({', '.join(f'{value:.0f}' for value in color)})" for color in colors
        )
        return f"linear-gradient(to right, {stops})"

    return (
        f":root {{ --near-to-far: {gradient(NEAR_TO_FAR)}; "
        f"--unsure-to-sure: {gradient(UNSURE_TO_SURE)}; }}\n"
    )


def _filled(template: str, **parts: str) -> str:
    return Template(_resource(template)).substitute(parts)


def _resource(name: str) -> str:
    return files("mvsam.apps.report").joinpath(name).read_text(encoding="utf-8")
