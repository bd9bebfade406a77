"""Whole files only: written under a temporary name, then renamed.

Whoever reads a folder while we write, or after a crash, finds complete files or none.
"""

import errno
import json
import os
import re
import secrets
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from mvsam.errors import InputError

PARTIAL = ".part"
"""Ending of a file that is still being written."""
_OF_WRITE_WHOLE = re.compile(rf"\..+\.[0-9a-f]{{8}}{re.escape(PARTIAL)}")


class DiskFullError(RuntimeError):
    """The disk has no room; what was written before is whole (exit code 1)."""


@contextmanager
def disk_full_as_sentence(path: Path) -> Iterator[None]:
    """Turns the system's "no space left" into a sentence that names the file and the remedy."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise DiskFullError(
            f"the disk is full: no room for {path}; free some space and run the same command again"
        ) from error


def write_whole(path: Path, save: Callable[[BinaryIO], Any]) -> None:
    """Writes what `save(file)` produces to a temporary neighbour of `path`, then renames that.

    Nothing is left behind when writing fails, be it a full disk or Ctrl-C. Processes, on several
    machines too, may write the same file at once: the last one stays.
    """
    # Pillow writes straight to the descriptor of a real file and overlooks a write that a nearly
    # full disk cuts short; Python's own write of the finished bytes does not.
    content = BytesIO()
    save(content)
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}{PARTIAL}")
    with disk_full_as_sentence(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with partial.open("wb") as file:
                file.write(content.getbuffer())
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)


def read_array(path: Path, name: str) -> np.ndarray:
    """An array of an uncompressed `.npz`, or InputError for a file that is damaged.

    Its checksum comes first, because NumPy takes the memory that a damaged header asks for.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            content = BytesIO(archive.read(f"{name}.npy"))
        return np.lib.format.read_array(content, allow_pickle=False)
    except Exception as error:  # zipfile raises many kinds for damaged data
        raise InputError(
            f"{path}: {name} cannot be read ({error}); remove the file, and it is made anew."
        ) from error


def write_json(path: Path, value: Any) -> None:
    """Indented JSON, written whole."""
    text = json.dumps(value, indent=2) + "\n"
    write_whole(path, lambda file: file.write(text.encode()))


def write_matrix(path: Path, matrix: np.ndarray) -> None:
    """Rows of numbers with nine digits, written whole."""
    write_whole(path, lambda file: np.savetxt(file, matrix, fmt="%.9g"))


def remove_partial_files(folder: Path) -> None:
    """Removes what a killed `write_whole` left unfinished anywhere below `folder`."""
    for partial in folder.rglob(f".*{PARTIAL}"):
        if _OF_WRITE_WHOLE.fullmatch(partial.name):
            partial.unlink(missing_ok=True)


def writable_folder(folder: Path) -> Path:
    """`folder`, created where missing; `InputError` where nothing can be written into it."""
    probe = folder / f".writable.{secrets.token_hex(4)}{PARTIAL}"
    try:
        with disk_full_as_sentence(folder):
            folder.mkdir(parents=True, exist_ok=True)
            probe.touch()
            probe.unlink(missing_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        file = next(path for path in (folder, *folder.parents) if path.is_file())
        raise InputError(
            f"{file} is a file, so there can be no output folder {folder}: choose another "
            "--out, or move the file away."
        ) from error
    except OSError as error:
        raise InputError(
            f"output folder {folder} is not writable ({error.strerror}): "
            "choose another --out or change its permissions"
        ) from error
    return folder
