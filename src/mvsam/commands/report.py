"""`mvsam report`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from mvsam.commands.shared import progress_bar
from mvsam.errors import InputError
from mvsam.reconstruction.settings import CloudSettings


@dataclass(frozen=True)
class Report:
    """One HTML page about the maps that mvsam predict wrote.

    Holds the point cloud to turn and zoom, coloured by photo, class or confidence, the scores, the
    share of each class, and every photo beside its maps. It is a single file that needs no network.

    Example: mvsam report out/my_room
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """The --out folder of mvsam predict."""
    out: Path | None = None
    """The page; DIR/report.html where it is not given."""
    settings: Annotated[CloudSettings, tyro.conf.arg(name="")] = field(
        default_factory=CloudSettings
    )

    def run(self) -> None:
        path = report(self)
        print(f"{path}: {path.stat().st_size / 1e6:.1f} MB, open it in a browser")


def report(arguments: Report) -> Path:
    """Builds the page with a progress bar and writes it; returns where it lies."""
    from mvsam.apps.report.page import build_page, count_steps
    from mvsam.apps.report.photos import read_photos
    from mvsam.files import writable_folder, write_whole

    path = arguments.out or arguments.folder / "report.html"
    if path.is_dir():
        raise InputError(f"{path} is a folder: give --out a file, as {path / 'report.html'}.")
    if path.suffix not in (".html", ".htm"):
        raise InputError(f"{path} must end in .html.")
    photos = read_photos(arguments.folder)
    writable_folder(path.parent)
    with progress_bar() as progress:
        task = progress.add_task("report", total=count_steps(photos))
        page = build_page(
            arguments.folder, photos, arguments.settings, lambda: progress.advance(task)
        )
    write_whole(path, lambda file: file.write(page.encode()))
    return path
