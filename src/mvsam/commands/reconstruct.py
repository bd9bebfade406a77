"""`mvsam reconstruct`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mvsam.commands.shared import progress_bar
from mvsam.errors import InputError
from mvsam.reconstruction.settings import CloudSettings

if TYPE_CHECKING:
    from mvsam.reconstruction.export import Model3D


@dataclass(frozen=True)
class Reconstruct:
    """A labelled point cloud or mesh from the maps that mvsam predict wrote.

    A depth is kept where it is confident and other photos agree with it. Points are then merged per
    voxel; with --mesh the depths are fused into one surface. PLY carries x y z in metres, colour,
    label and confidence of points and of vertices; GLB colour alone.

    Example: mvsam reconstruct out/my_room --out room.glb --mesh
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """The --out folder of mvsam predict."""
    out: Path
    """The cloud or mesh, .ply or .glb (GLB needs pip install 'mvsam[reconstruct]')."""
    mesh: bool = False
    """Make a surface of triangles (needs pip install 'mvsam[reconstruct]')."""
    color: Literal["photo", "label"] = "photo"
    """Colour points as photographed, or by their class."""
    settings: Annotated[CloudSettings, tyro.conf.arg(name="")] = field(
        default_factory=CloudSettings
    )

    def run(self) -> None:
        shares: dict[str, float] = {}
        model = reconstruct(self, shares.__setitem__)
        least = min(shares, key=lambda name: shares[name])
        typical = median(shares.values())
        print(
            f"{self.out}: {size_of(model)}; {typical:.0%} of a photo's depths passed (median), "
            f"least of {least}: {shares[least]:.0%}"
        )


def reconstruct(
    arguments: Reconstruct, on_photo: Callable[[str, float], None] = lambda name, share: None
) -> Model3D:
    """Builds the cloud or the mesh with a progress bar and writes it.

    `on_photo` is called after each photo with its name and the share of its depths that passed.
    """
    from mvsam.files import writable_folder
    from mvsam.reconstruction.cloud import build_cloud
    from mvsam.reconstruction.export import check_target, colored_by_label, write_model
    from mvsam.reconstruction.folder import read_predictions
    from mvsam.reconstruction.mesh import build_mesh

    check_target(arguments.out)
    views = read_predictions(arguments.folder)
    if arguments.color == "label" and views[0].label_path is None:
        raise InputError(f"{arguments.folder} holds no labels: leave --color label out.")
    writable_folder(arguments.out.parent)
    with progress_bar() as progress:
        task = progress.add_task("reconstruct", total=len(views))
        build = build_mesh if arguments.mesh else build_cloud

        def advance(name: str, share: float) -> None:
            progress.advance(task)
            on_photo(name, share)

        model = build(views, arguments.settings, advance)
    if arguments.color == "label":
        model = colored_by_label(model, views[0].palette())
    write_model(arguments.out, model)
    return model


def size_of(model: Model3D) -> str:
    """Its points, or triangles, in words."""
    from mvsam.reconstruction.mesh import Mesh

    if isinstance(model, Mesh):
        return f"{len(model.faces):,} triangles"
    return f"{len(model):,} points"
