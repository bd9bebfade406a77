"""Which reader opens a scene: found from the files in the folder, or named."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mvsam.data.about import About
from mvsam.data.readers.arkitscenes import is_arkitscenes, open_arkitscenes
from mvsam.data.readers.colmap import is_colmap, open_colmap
from mvsam.data.readers.icl_nuim import is_icl_nuim, open_icl_nuim
from mvsam.data.readers.ios_logger import is_ios_logger, open_ios_logger
from mvsam.data.readers.nerfstudio import is_nerfstudio, open_nerfstudio
from mvsam.data.readers.posed_folder import PosedFolder, is_posed_folder
from mvsam.data.readers.replica import is_replica, open_replica
from mvsam.data.readers.scannet import (
    is_scannet_folder,
    is_sens,
    open_scannet_folder,
    open_sens,
)
from mvsam.data.readers.seven_scenes import is_seven_scenes, open_seven_scenes
from mvsam.data.readers.structure import photo_folder, pose_photos
from mvsam.data.readers.tum import is_tum, open_tum
from mvsam.data.readers.video import VIDEO_SUFFIXES
from mvsam.data.refined import RefinedScene
from mvsam.data.scaled import ScaledScene, in_metres, parse_scale
from mvsam.errors import InputError
from mvsam.types import Scene

Poses = Literal["given", "refined", "colmap"]

log = logging.getLogger("mvsam")


@dataclass(frozen=True)
class Format:
    """One way to keep a scene in a folder."""

    matches: Callable[[Path], bool]
    """Whether its characteristic files lie in a folder."""
    open: Callable[[Path], Scene]


FORMATS = {
    "scannet-sens": Format(is_sens, open_sens),
    "scannet": Format(is_scannet_folder, open_scannet_folder),
    "posed-folder": Format(is_posed_folder, PosedFolder),
    "nerfstudio": Format(is_nerfstudio, open_nerfstudio),
    "colmap": Format(is_colmap, open_colmap),
    "tum": Format(is_tum, open_tum),
    "7-scenes": Format(is_seven_scenes, open_seven_scenes),
    "icl-nuim": Format(is_icl_nuim, open_icl_nuim),
    "ios-logger": Format(is_ios_logger, open_ios_logger),
    "arkitscenes": Format(is_arkitscenes, open_arkitscenes),
    "replica": Format(is_replica, open_replica),
}
"""By the name that `--format` takes; the first that matches a folder is taken."""


def open_scene(
    path: str | Path, format: str | None = None, scale: float | str = 1.0, poses: Poses = "given"
) -> Scene:
    """The scene stored at `path`; the format is found from the files unless it is named.

    scale: metres that one unit of the poses has, 1 for formats that are metric; or the metres
    between two photos' cameras, as "0001.jpg:0007.jpg=0.25". poses: "refined" lets the photos
    correct those that are given; "colmap" lets COLMAP find those of a folder of photos, or of a
    video, first.
    """
    path, parsed_scale = Path(path), parse_scale(scale)
    if poses == "colmap":
        path, format = pose_photos(path), format or "colmap"
    if not path.is_dir():
        found = "this is a file, not a scene" if path.exists() else "there is no such folder"
        raise InputError(f"{path}: {found}; give the path of a scene's folder{_advice(path)}.")
    name = format or find_format(path)
    if name is None:
        raise InputError(
            f"{path}: this is no scene we know ({', '.join(FORMATS)}); the simplest is a posed "
            f"folder with color/NAME.jpg, poses/NAME.txt and intrinsics.txt{_advice(path)}."
        )
    if name not in FORMATS:
        raise InputError(f"{path}: unknown format {name!r}; choose one of {', '.join(FORMATS)}.")
    scene = FORMATS[name].open(path)
    if parsed_scale != 1.0 and isinstance(scene, ScaledScene):
        raise InputError(
            f"{path}: the depth beside the photos tells the scale; leave --scale out, or move the "
            "folder depth/ away."
        )
    scene = in_metres(scene, parsed_scale)
    if not About.of(scene).has_unit:
        log.warning(
            "%s: poses of COLMAP have no unit, so their scale is unknown; depths are metric only "
            "if they were aligned, or with --scale, metres a unit or between the cameras of two "
            "photos.",
            path,
        )
    return RefinedScene(scene) if poses == "refined" else scene


def _advice(path: Path) -> str:
    """For photos without poses."""
    is_video = path.is_file() and path.suffix.lower() in VIDEO_SUFFIXES
    if is_video or (path.is_dir() and photo_folder(path)):
        return ", or let --poses colmap find the poses"
    return ""


def find_format(path: Path) -> str | None:
    """The name of the format whose characteristic files lie in the folder `path`, or None.

    A folder with `color/` that matches none is a posed folder whose poses are missing.
    """
    incomplete = "posed-folder" if (path / "color").is_dir() else None
    return next((name for name, format in FORMATS.items() if format.matches(path)), incomplete)
