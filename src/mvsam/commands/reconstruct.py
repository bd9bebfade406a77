"""`mvsam reconstruct`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mvsam.commands.shared import progress_bar
from mvsam.errors import InputError
from mvsam.reconstruction.settings import CloudSettings

if TYPE_CHECKING:
    from mvsam.reconstruction.cloud import PointCloud


@dataclass(frozen=True)
class Reconstruct:
    """A labelled point cloud from the maps that mvsam predict wrote.

    A depth is kept where it is confident and other photos agree with it; points are then merged
    per voxel. PLY carries x y z in metres, colour, label and confidence; GLB colour alone.

    Example: mvsam reconstruct out/my_room --out room.ply
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """The --out folder of mvsam predict."""
    out: Path
    """The cloud, .ply or .glb."""
    color: Literal["photo", "label"] = "photo"
    """Colour points as photographed, or by their class."""
    settings: Annotated[CloudSettings, tyro.conf.arg(name="")] = field(
        default_factory=CloudSettings
    )

    def run(self) -> None:
        cloud = reconstruct(self)
        print(f"{self.out}: {len(cloud):,} points")


def reconstruct(arguments: Reconstruct) -> PointCloud:
    """Builds the cloud with a progress bar and writes it."""
    from mvsam.files import writable_folder
    from mvsam.reconstruction.cloud import build_cloud
    from mvsam.reconstruction.export import colored_by_label, write_cloud
    from mvsam.reconstruction.folder import read_predictions

    if arguments.out.suffix.lower() not in (".ply", ".glb"):
        raise InputError(f"{arguments.out} must end in .ply or .glb.")
    views = read_predictions(arguments.folder)
    writable_folder(arguments.out.parent)
    with progress_bar() as progress:
        task = progress.add_task("reconstruct", total=len(views))
        cloud = build_cloud(views, arguments.settings, lambda: progress.advance(task))
    if arguments.color == "label":
        if views[0].label_path is None:
            raise InputError(f"{arguments.folder} holds no labels: leave --color label out.")
        cloud = colored_by_label(cloud, views[0].palette())
    write_cloud(arguments.out, cloud)
    return cloud
