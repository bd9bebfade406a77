"""Which reader opens a scene: found from the files in the folder, or named."""

from collections.abc import Callable
from pathlib import Path

from mvsam.data.posed_folder import PosedFolder
from mvsam.data.readers import nerfstudio
from mvsam.data.readers.nerfstudio import open_nerfstudio
from mvsam.errors import InputError
from mvsam.types import Scene

READERS: dict[str, Callable[[Path], Scene]] = {
    "posed-folder": PosedFolder,
    "nerfstudio": open_nerfstudio,
}
"""Format name -> reader."""


def open_scene(path: str | Path, format: str | None = None) -> Scene:
    """The scene stored at `path`; the format is found from the files unless it is named."""
    path = Path(path)
    if not path.is_dir():
        is_file = "this is a file, not" if path.exists() else "there is no such folder as"
        raise InputError(f"{path}: {is_file} a scene; give the path of a scene's folder.")
    name = format or find_format(path)
    if name is None:
        raise InputError(
            f"{path}: this is no scene we know; expected a posed folder with color/NAME.jpg, "
            "poses/NAME.txt and intrinsics.txt."
        )
    if name not in READERS:
        raise InputError(f"{path}: unknown format {name!r}; choose one of {', '.join(READERS)}.")
    return READERS[name](path)


def find_format(path: Path) -> str | None:
    """The name of the format whose characteristic files lie in the folder `path`, or None."""
    if (path / "color").is_dir():
        return "posed-folder"
    return "nerfstudio" if (path / nerfstudio.FILE).is_file() else None
