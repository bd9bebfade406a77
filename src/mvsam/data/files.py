"""Reading one file of a scene, with an error that names it: photos, depth, labels, matrices.

Pictures are read as they are stored: an EXIF orientation is not applied, because intrinsics and
poses belong to the stored pixels.
"""

import logging
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float64, UInt8
from PIL import ExifTags, Image

from mvsam.errors import InputError
from mvsam.geometry.depth_map import from_millimetres
from mvsam.types import IGNORE

log = logging.getLogger("mvsam")

_FILE_FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
"""What Pillow may take a picture for: it knows forty more, and runs Ghostscript for some."""
PHOTO_MODES = ("RGB", "RGBA", "L", "LA", "P", "CMYK", "YCbCr")
DEPTH_MODES = ("I;16", "I;16B", "I;16L", "I")  # "I" is what older Pillow calls a 16-bit PNG
LABEL_MODES = ("L", "P")

Size = tuple[int, int]


def is_file(path: Path) -> bool:
    """Whether a file is there, links followed; none can be under a name of a thousand letters."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def read_header(path: Path, kind: str = "photo") -> tuple[Size, str]:
    """((width, height), Pillow mode) of a picture without decoding its pixels."""
    try:
        with Image.open(path, formats=_FILE_FORMATS) as picture:
            if kind == "photo" and _is_turned(picture):
                _warn_of_rotation(path.parent)
            return picture.size, picture.mode
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise _unreadable(path, kind, error) from error


def _is_turned(picture: Image.Image) -> bool:
    """Whether viewers show a JPEG turned or mirrored, as a note beside the pixels asks them to."""
    if picture.format != "JPEG":  # a PNG's note may lie behind the pixels, which are not read here
        return False
    try:
        return picture.getexif().get(ExifTags.Base.Orientation, 1) not in (0, 1)
    except Exception:  # Pillow raises many kinds for damaged notes, which are none of our business
        return False


@cache
def _warn_of_rotation(folder: Path) -> None:
    """Once a folder."""
    log.warning(
        "%s: has photos with an EXIF rotation, which is not applied: intrinsics and poses must be "
        "those of the pixels as they are stored.",
        folder,
    )


def check_photo(path: Path) -> Size:
    """(width, height) of an 8-bit photo, from its header."""
    size, mode = read_header(path)
    if mode not in PHOTO_MODES:
        raise InputError(
            f"{path}: the photo has pixel type {mode}; convert it to an 8-bit RGB JPEG or PNG."
        )
    return size


def check_map(path: Path, kind: str, photo_size: Size) -> None:
    """Raise unless the header of a depth or label PNG fits its photo."""
    size, mode = read_header(path, f"{kind} map")
    modes, expected = {
        "depth": (DEPTH_MODES, "a 16-bit greyscale PNG in millimetres"),
        "label": (LABEL_MODES, "an 8-bit PNG of class numbers"),
    }[kind]
    if mode not in modes:
        raise InputError(
            f"{path}: the {kind} map has pixel type {mode}, expected {expected}; convert it."
        )
    if size != photo_size:
        raise InputError(
            f"{path}: the {kind} map is {size[0]}x{size[1]} but its photo is "
            f"{photo_size[0]}x{photo_size[1]}; align and resize it to the photo (nearest)."
        )


def load_photo(path: Path) -> UInt8[np.ndarray, "height width 3"]:
    """RGB."""
    return _decode(path, "photo", convert="RGB")


def load_depth(path: Path) -> Float[np.ndarray, "height width"]:
    """Metres as float32 from 16-bit millimetres; 0 = unknown."""
    pixels = _decode(path, "depth map")
    if pixels.ndim != 2 or pixels.dtype == np.uint8:
        kind = "colours" if pixels.ndim != 2 else "8 bits"
        raise InputError(
            f"{path}: the depth map has {kind}, expected a 16-bit greyscale PNG in millimetres; "
            "export it again."
        )
    return from_millimetres(pixels)


def load_labels(path: Path, num_classes: int) -> UInt8[np.ndarray, "height width"]:
    """0..num_classes-1 or `IGNORE`; any other value is an error."""
    labels = _decode(path, "label map")
    if (strange := labels[(labels >= num_classes) & (labels != IGNORE)]).size:
        raise InputError(
            f"{path}: label {strange.max()} is neither 0..{num_classes - 1} nor {IGNORE} (ignore); "
            "map the labels to these classes or describe yours in classes.json."
        )
    return labels


def load_pixels(path: Path, kind: str) -> np.ndarray:
    """A map's values as they are stored; `kind` is what the error calls it."""
    return _decode(path, kind)


def _decode(path: Path, kind: str, convert: str | None = None) -> np.ndarray:
    try:
        with Image.open(path, formats=_FILE_FORMATS) as picture:
            return np.array(picture.convert(convert) if convert else picture)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise _unreadable(path, kind, error) from error


def _unreadable(path: Path, kind: str, error: Exception) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(f"{path}: the {kind} is missing; put it back or leave this frame out.")
    return InputError(
        f"{path}: the {kind} cannot be read ({error}); copy it again or leave this frame out."
    )


def load_matrix(path: Path, rows: int, columns: int, meaning: str) -> Float64[np.ndarray, "r c"]:
    """A matrix of exactly this shape from a text file; `meaning` is what the error calls it."""
    try:
        lines = path.read_text(encoding="utf-8-sig").replace(",", " ").splitlines()
        table = [[float(word) for word in line.split()] for line in lines if line.strip()]
    except FileNotFoundError as error:
        raise InputError(f"{path}: the file is missing; it holds the {meaning}.") from error
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: the {meaning} cannot be read ({error}); "
            f"write {rows} lines of {columns} numbers."
        ) from error
    if len(table) != rows or any(len(row) != columns for row in table):
        raise InputError(
            f"{path}: the {meaning} is not {rows}x{columns} ({_shape_in_words(table)}); "
            f"write {rows} lines of {columns} numbers."
        )
    return np.array(table)


def _shape_in_words(table: list[list[float]]) -> str:
    widths = {len(row) for row in table}
    if not table:
        return "the file is empty"
    if len(widths) > 1:
        return f"{len(table)} lines of unequal length"
    return f"it is {len(table)}x{widths.pop()}"
