"""`mvsam view`."""

from __future__ import annotations

import os
import sys
import webbrowser
from dataclasses import dataclass
from typing import Annotated

import tyro

from mvsam.commands.report import Report, report


@dataclass(frozen=True)
class View:
    """Makes the page of mvsam report anew and opens it in the browser.

    Its point cloud turns and zooms, in the colours of photos, classes or confidence. On a machine
    without a screen copy the page to one that has one: it is a single file.

    Example: mvsam view out/my_room
    """

    page: Annotated[Report, tyro.conf.arg(name="")]

    def run(self) -> None:
        path = report(self.page)
        is_open = _has_screen() and webbrowser.open(path.resolve().as_uri())
        print(f"{path}: {'opened' if is_open else 'no browser found here, open it in one'}")


def _has_screen() -> bool:
    """Else `webbrowser` may give the terminal to a browser of text."""
    return sys.platform != "linux" or bool({"DISPLAY", "WAYLAND_DISPLAY"} & os.environ.keys())
