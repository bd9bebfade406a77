"""`mvsam view`."""

from __future__ import annotations

import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mvsam.commands.report import Report, report


@dataclass(frozen=True)
class View:
    """Makes the page of mvsam report anew and opens it in the browser.

    Its point cloud turns and zooms, in the colours of photos, classes or confidence. On a machine
    without a browser copy the page to one that has one: it is a single file.

    Example: mvsam view out/my_room
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """The --out folder of mvsam predict."""

    def run(self) -> None:
        page = report(Report(self.folder))
        is_open = webbrowser.open(page.resolve().as_uri())
        print(f"{page}: {'opened' if is_open else 'no browser found here, open it in one'}")
