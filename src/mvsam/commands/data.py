"""`mvsam data check`, `mvsam data convert` and `mvsam data scannet`."""

from __future__ import annotations

import os
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mvsam.commands.shared import Json, Scale, for_each_scene, print_json, progress_bar
from mvsam.errors import InputError, counted

if TYPE_CHECKING:
    from mvsam.data.check.report import SceneReport
    from mvsam.types import Scene

Scenes = Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SCENE")]


@dataclass(frozen=True)
class Check:
    """What a scene holds, and whether its cameras fit its photos and its depth.

    Example: mvsam data check my_room
    """

    scene: Scenes
    """A scene's folder in any format, or rooms:val:0-1."""
    depth_range: tuple[float, float] = (0.1, 5.0)
    """Metres between which surfaces are expected."""
    format: str | None = None
    """The folder's format; none: found from its files."""
    scale: Scale = 1.0
    poses: Literal["given", "refined", "colmap"] = "given"
    """refined: let the photos correct the given ones; colmap: let COLMAP find them for a folder of
    photos or a video, which takes minutes."""
    json: Json = False
    strict: bool = False
    """End with exit code 1 where the cameras of a scene are wrong, for scripts."""

    def run(self) -> None:
        from mvsam.data.catalog import open_data
        from mvsam.data.check.report import report_scene
        from mvsam.data.depth_range import checked_depth_range

        depth_range = checked_depth_range(self.depth_range)
        scenes = open_data(self.scene, self.format, scale=self.scale, poses=self.poses)
        reports: list[SceneReport] = []

        def check(scene: Scene) -> None:
            reports.append(report_scene(scene, depth_range))
            if not self.json:
                print(f"{_as_text(reports[-1])}\n")

        failure = for_each_scene(scenes, check)
        if self.json:
            print_json(
                [
                    asdict(report)
                    | {"verdict": report.verdict, "is_suspicious": report.is_suspicious}
                    for report in reports
                ]
            )
        if failure is not None:
            raise failure
        if self.strict and any(report.is_suspicious for report in reports):
            sys.exit(1)


@dataclass(frozen=True)
class Convert:
    """A scene of any format as a posed folder or in nerfstudio's form.

    Example: mvsam data convert scans/scene0000_00 --out data/scene0000_00
    """

    scene: Scenes
    """A scene's folder in any format, or rooms:val:0-1."""
    out: Path
    """The new folder; of several scenes each becomes a folder in it."""
    to: Literal["posed-folder", "nerfstudio"] = "posed-folder"
    """The form to write."""
    format: str | None = None
    """The folder's format; none: found from its files."""
    scale: Scale = 1.0
    poses: Literal["given", "refined", "colmap"] = "given"
    """refined: let the photos correct the given ones; colmap: let COLMAP find them for a folder of
    photos or a video, which takes minutes."""

    def run(self) -> None:
        from mvsam.data.catalog import open_data
        from mvsam.data.convert import write_nerfstudio, write_posed_folder
        from mvsam.files import writable_folder

        write = {"posed-folder": write_posed_folder, "nerfstudio": write_nerfstudio}[self.to]
        scenes = open_data(self.scene, self.format, scale=self.scale, poses=self.poses)
        if self.out.resolve() == Path(self.scene).resolve():
            raise InputError(f"{self.out}: is the scene itself; give another folder as --out.")
        writable_folder(self.out)
        with progress_bar() as progress:
            for scene in scenes:
                folder = self.out / Path(scene.name).name if len(scenes) > 1 else self.out
                names = write(scene, folder)
                for _ in progress.track(names, total=len(scene), description=scene.name):
                    pass
        print(f"{counted(len(scenes), 'scene')} in {self.out}")


@dataclass(frozen=True)
class ScanNet:
    """Frames of ScanNet's .sens files as folders of pictures, in several processes.

    Frames that are there already are skipped, so a stopped run goes on with the same command.

    Example: mvsam data scannet scans --out exported --every 20 --tuples mvs2d
    """

    scans: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SCANS")]
    """A scan's folder, a folder of such, or a list beside them (scannetv2_val.txt)."""
    out: Path
    """The new folder; each scan becomes a folder in it."""
    every: int = 1
    """Write every so many frames."""
    size: tuple[int, int] | None = None
    """Width and height of the photos; where it is not given, they are copied as they are."""
    tuples: str | None = None
    """Which frames go together, as in mvsam eval: mvs2d, every-100, keyframes or a file; written as
    views.txt, so that training and prediction follow it too. Scans that a file does not name are
    left out."""
    views: int = 3
    """Frames in each of these tuples."""
    workers: int | None = None
    """Processes; one a core where it is not given."""

    def run(self) -> None:
        from mvsam.data.scannet_export import (
            copy_table,
            export,
            find_scans,
            named_scans,
            plan,
            write_views,
        )
        from mvsam.files import writable_folder

        if self.every < 1:
            raise InputError(f"--every {self.every} writes no frame; give 1 or more.")
        if self.size is not None and min(self.size) < 1:
            raise InputError("--size {} {} is no size; give width and height.".format(*self.size))
        scans = find_scans(self.scans)
        if self.tuples is not None:
            scans = named_scans(scans, self.tuples)
        writable_folder(self.out)
        copy_table(scans, self.out)
        with progress_bar() as progress:
            for scan in scans:
                folder = self.out / scan.resolve().name
                jobs, done = plan(scan, folder, self.every, self.size)
                total = done + sum(len(job.frames) for job in jobs)
                task = progress.add_task(folder.name, total=total, completed=done)
                for frames in export(jobs, self.workers or os.cpu_count() or 1):
                    progress.advance(task, frames)
                if self.tuples is not None:
                    write_views(folder, self.tuples, self.views)
        print(f"{counted(len(scans), 'scan')} in {self.out}")


@dataclass(frozen=True)
class Data:
    """Scenes on disk: look what is in them, whether their cameras can be right; convert them."""

    action: tyro.conf.OmitSubcommandPrefixes[
        Annotated[Check, tyro.conf.subcommand("check")]
        | Annotated[Convert, tyro.conf.subcommand("convert")]
        | Annotated[ScanNet, tyro.conf.subcommand("scannet")]
    ]

    def run(self) -> None:
        self.action.run()


def _as_text(report: SceneReport) -> str:
    sizes = ", ".join(f"{width}x{height}" for width, height in report.sizes)
    lost = f", {report.num_lost} more without a pose" if report.num_lost else ""
    lines = [f"{report.name}: {counted(report.num_frames, 'photo')} of {sizes}{lost}"]
    if report.baselines:
        unit = "m" if report.has_unit else "units of the model"
        lines.append(
            "  nearest camera   {:.2f} / {:.2f} / {:.2f} ".format(*report.baselines)
            + f"{unit} away, "
            + "{:.0f} / {:.0f} / {:.0f} degrees turned (least / median / most)".format(
                *report.turns
            )
        )
    if report.depth_coverage is None:
        lines.append("  depth            none")
    else:
        span = " / ".join(f"{depth:.2f}" for depth in report.depths)
        lines.append(
            f"  depth            {counted(report.num_depth, 'photo')}, "
            f"{report.depth_coverage:.0%} of their "
            f"pixels; {span} m (1st / 50th / 99th percentile)"
        )
    shares = sorted(report.label_shares.items(), key=lambda item: -item[1])
    named = ", ".join(f"{name} {share:.0%}" for name, share in shares if share >= 0.005)
    labelled = f"{counted(report.num_labels, 'photo')}: {named}" if named else "none"
    lines.append(f"  labels           {labelled}")
    photos = report.photo_hint or "nothing speaks against the poses."
    if report.depth_verdict.fits is not None:
        photos = "not asked, because the depth can tell."
    lines.append(f"  by the photos    {photos}")
    lines.append(f"  by the depth     {report.depth_verdict.sentence}")
    lines.append(f"  by features      {report.features.sentence}")
    lines.append(f"  verdict          {_verdict(report)}")
    return "\n".join(lines)


def _verdict(report: SceneReport) -> str:
    if report.num_frames < 2:
        return "one photo, and depth needs two or more; add some that overlap it."
    if report.evidence.is_suspicious or report.features.disagree:
        return "the cameras are wrong; correct them as said above."
    if report.features.mistaken:
        names = ", ".join(report.features.mistaken)
        return f"the cameras of {names} are wrong; correct them, or leave those photos out."
    if report.verdict == "imprecise":
        unit = "" if report.has_unit else "--scale (poses in metres) and "
        return f"the cameras are imprecise; add {unit}--poses refined, with another --out."
    if report.depth_verdict.fits:
        return "the cameras fit."
    if report.verdict == "fits":
        return "the cameras fit the photos; nothing here tests their unit."
    if report.depth_verdict.agreement:
        return "not enough evidence for or against the cameras."
    return "nothing found against the cameras."
