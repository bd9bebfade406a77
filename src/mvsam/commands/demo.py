"""`mvsam demo`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from mvsam.commands.predict import Predict, predict_with_bar
from mvsam.commands.reconstruct import Reconstruct, reconstruct, size_of
from mvsam.commands.report import Report, report
from mvsam.commands.shared import Device, load_model, print_table
from mvsam.errors import InputError, MissingExtraError

if TYPE_CHECKING:
    from mvsam.inference.scene import SceneResult

SAMPLE = Path(__file__).parents[1] / "assets" / "sample"
"""Five views of one room, rooms:val:0 of version 4, as a posed folder."""


@dataclass(frozen=True)
class Demo:
    """The main job on the sample room that comes with the package, with its weights.

    Writes the maps of five photos, scores against the truth, a labelled point cloud, a mesh, and a
    page that shows it all. Needs no network, no GPU and no other data.

    Example: mvsam demo --out out/demo
    """

    out: Path = Path("out/demo")
    """Folder for all of it."""
    device: Device = "auto"
    """Where the network runs; auto takes a GPU where there is one."""

    def run(self) -> None:
        from mvsam.data.formats import open_scene
        from mvsam.inference.outputs import OutputFolder

        before = OutputFolder(self.out).read_run()
        if before is not None and (scene := before.get("scene")) != SAMPLE.name:
            raise InputError(
                f"{self.out} holds predictions of scene {scene}: choose another --out."
            )
        # Always anew: a demo of another version must not count as done.
        arguments = Predict(scene=str(SAMPLE), out=self.out, overwrite=True, device=self.device)
        model = load_model(arguments.model, self.device)
        result = predict_with_bar(arguments, model, open_scene(SAMPLE), self.out)
        by_photo = Reconstruct(self.out, self.out / "room.ply")
        by_label = replace(by_photo, out=self.out / "room_labels.ply", color="label")
        cloud = reconstruct(by_photo)
        reconstruct(by_label)
        page = report(Report(self.out))
        _say(self.out, result, size_of(cloud), page)
        _make_mesh(replace(by_photo, out=self.out / "room.glb", mesh=True))


def _make_mesh(arguments: Reconstruct) -> None:
    """Last, as what it needs does not come with a plain installation."""
    try:
        size = size_of(reconstruct(arguments))
    except MissingExtraError as error:
        print(f"Mesh:     none, {error}")
    else:
        print(f"Mesh:     {arguments.out} ({size})")


def _say(out: Path, result: SceneResult, cloud_size: str, page: Path) -> None:
    assert result.scores is not None  # the sample has ground truth
    print_table(result.scores.as_table())
    print(f"Pictures: {out / 'preview'} (photo, depth, labels side by side)")
    print(f"Maps:     {out / 'depth'}, {out / 'confidence'}, {out / 'labels'}")
    print(f"Cloud:    {out / 'room.ply'} and room_labels.ply ({cloud_size})")
    print(f"Scores:   {out / 'metrics.json'}")
    print(f"Page:     {page}, which shows it all in a browser")
