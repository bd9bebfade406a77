"""Which reader opens a scene: found from the files in the folder, or named."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from mvsam.data.posed_folder import PosedFolder, is_posed_folder
from mvsam.data.readers.colmap import is_colmap, open_colmap
from mvsam.data.readers.nerfstudio import is_nerfstudio, open_nerfstudio
from mvsam.data.readers.replica import is_replica, open_replica
from mvsam.data.readers.scannet import (
    is_scannet_folder,
    is_sens,
    open_scannet_folder,
    open_sens,
)
from mvsam.data.readers.seven_scenes import is_seven_scenes, open_seven_scenes
from mvsam.data.readers.tum import is_tum, open_tum
from mvsam.data.scaled import ScaledScene
from mvsam.errors import InputError
from mvsam.types import Scene


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
    "replica": Format(is_replica, open_replica),
}
"""By the name that `--format` takes; the first that matches a folder is taken."""


def open_scene(path: str | Path, format: str | None = None, scale: float = 1.0) -> Scene:
    """The scene stored at `path`; the format is found from the files unless it is named.

    scale: metres that one unit of the poses has; 1 for formats that are metric.
    """
    path = Path(path)
    if not path.is_dir():
        is_file = "this is a file, not" if path.exists() else "there is no such folder as"
        raise InputError(f"{path}: {is_file} a scene; give the path of a scene's folder.")
    name = format or find_format(path)
    if name is None:
        raise InputError(
            f"{path}: this is no scene we know ({', '.join(FORMATS)}); the simplest is a posed "
            "folder with color/NAME.jpg, poses/NAME.txt and intrinsics.txt."
        )
    if name not in FORMATS:
        raise InputError(f"{path}: unknown format {name!r}; choose one of {', '.join(FORMATS)}.")
    scene = FORMATS[name].open(path)
    return scene if scale == 1.0 else ScaledScene(scene, scale)


def find_format(path: Path) -> str | None:
    """The name of the format whose characteristic files lie in the folder `path`, or None."""
    return next((name for name, format in FORMATS.items() if format.matches(path)), None)
