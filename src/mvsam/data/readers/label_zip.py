"""ScanNet's `SCENE_2d-label-filt.zip`: a scan's label pictures, named by frame number.

`SCENE_2d-label.zip` holds the same before ScanNet filtered them.
"""

import zipfile
from pathlib import Path

from mvsam.errors import InputError

LARGEST_PICTURE = 64 * 2**20
"""Bytes of one unpacked PNG; ScanNet's have a few thousand."""


def find_label_zip(scan: Path) -> Path | None:
    """The scan's label zip, the filtered one if both are there."""
    names = ("*_2d-label-filt.zip", "*_2d-label.zip")
    return next((file for name in names for file in sorted(scan.glob(name))), None)


def list_labels(archive: Path) -> dict[int, str]:
    """Frame number -> name in the archive."""
    try:
        with zipfile.ZipFile(archive) as file:
            names = [name for name in file.namelist() if name.lower().endswith(".png")]
        return {int(Path(name).stem): name for name in names if Path(name).stem.isdecimal()}
    except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        raise InputError(f"{archive}: cannot be read ({error}); download it again.") from error


def read_label(archive: Path, name: str) -> bytes:
    """The PNG of one frame; never more than `LARGEST_PICTURE` is unpacked."""
    try:
        with zipfile.ZipFile(archive) as file, file.open(name) as stream:
            data = stream.read(LARGEST_PICTURE + 1)
    except Exception as error:  # zipfile raises many kinds for damaged data
        raise InputError(
            f"{archive}: {name} cannot be read ({error}); download it again."
        ) from error
    if len(data) > LARGEST_PICTURE:
        raise InputError(
            f"{archive}: {name} has more than {LARGEST_PICTURE // 2**20} MB, which no label "
            "picture has; download it again."
        )
    return data
