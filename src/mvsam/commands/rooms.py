"""`mvsam rooms preview` and `mvsam rooms export`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mvsam.commands.shared import progress_bar
from mvsam.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from mvsam.types import Scene


@dataclass(frozen=True)
class Preview:
    """One picture of several rooms in a grid: photo, depth and labels of each.

    Example: mvsam rooms preview rooms:val:0-8 --out rooms.png
    """

    data: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROOMS")] = "rooms:val:0-6"
    """rooms:train, rooms:wide, rooms:around, rooms:val or rooms:test, and which of them."""
    out: Path = Path("rooms.png")
    """The picture, .png or .jpg."""
    assets: Path | None = None
    """Folder of an asset pack, whose things and surfaces are then among the rooms' own."""

    def run(self) -> None:
        rooms = _rooms(self.data, self.assets)
        import numpy as np
        from PIL import Image

        from mvsam.data.labels import SCANNET20
        from mvsam.files import writable_folder, write_whole
        from mvsam.rooms import preview_sheet

        Image.init()
        form = Image.EXTENSION.get(self.out.suffix.lower())
        if form is None:
            raise InputError(f"{self.out} must end in .png or .jpg.")
        writable_folder(self.out.parent)
        sheet = preview_sheet(list(rooms), np.array(SCANNET20.colors, np.uint8))
        write_whole(self.out, lambda file: sheet.save(file, format=form))
        print(self.out)


@dataclass(frozen=True)
class Export:
    """Rooms as posed folders with depth and labels, which every tool here reads.

    Example: mvsam rooms export rooms:val:0-10 --out data/rooms
    """

    data: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ROOMS")]
    """rooms:train, rooms:wide, rooms:around, rooms:val or rooms:test, and which of them."""
    out: Path
    """Each room becomes a folder in it."""
    assets: Path | None = None
    """Folder of an asset pack, whose things and surfaces are then among the rooms' own."""

    def run(self) -> None:
        rooms = _rooms(self.data, self.assets)
        from mvsam.data.convert import write_posed_folder
        from mvsam.files import writable_folder

        writable_folder(self.out)
        with progress_bar() as progress:
            for room in progress.track(rooms, description="export rooms"):
                for _ in write_posed_folder(room, self.out / Path(room.name).name, "PNG"):
                    pass
        print(f"{len(rooms)} rooms in {self.out}")


@dataclass(frozen=True)
class Rooms:
    """The procedural rooms with exact depth and labels: look at them, write them to disk."""

    action: tyro.conf.OmitSubcommandPrefixes[
        Annotated[Preview, tyro.conf.subcommand("preview")]
        | Annotated[Export, tyro.conf.subcommand("export")]
    ]

    def run(self) -> None:
        self.action.run()


def _rooms(data: str, assets: Path | None) -> Sequence[Scene]:
    from mvsam.data.catalog import is_rooms, open_data

    if not is_rooms(data):
        raise InputError(f"{data} does not name rooms; write for example rooms:val:0-6.")
    return open_data(data, assets=None if assets is None else str(assets))
