"""Readers, one per format, and what turns frames into a model's input."""

from collections.abc import Callable
from pathlib import Path

from mvsam.data.posed_folder import PosedFolder
from mvsam.errors import InputError
from mvsam.types import Scene

READERS: dict[str, Callable[[Path], Scene]] = {"posed-folder": PosedFolder}
"""Format name -> reader."""


def open_scene(path: str | Path, format: str | None = None) -> Scene:
    """The scene stored at `path`; the format is found from the files unless it is named."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such folder; check the path of the scene.")
    name = format or find_format(path)
    if name not in READERS:
        raise InputError(f"{path}: unknown format {name!r}; choose one of {', '.join(READERS)}.")
    return READERS[name](path)


def find_format(path: Path) -> str:
    """The name of the format whose characteristic files lie in `path`."""
    if (path / "color").is_dir():
        return "posed-folder"
    raise InputError(
        f"{path}: this is no scene we know; expected a posed folder with color/NAME.jpg, "
        "poses/NAME.txt and intrinsics.txt."
    )
