"""Whether COLMAP's binary files are as long as the counts in them say.

COLMAP itself takes memory for a count before it reads so many entries, and a damaged count of a
small file may be any number up to 2^64. The layouts are those of COLMAP's documentation,
little-endian without padding; each file begins with the number of its entries.
"""

import mmap
import struct
from collections.abc import Callable
from pathlib import Path

from mvsam.errors import InputError

PARAMETERS = {
    0: 3, 1: 4, 2: 4, 3: 5, 4: 8, 5: 8, 6: 12, 7: 5, 8: 4,
    9: 5, 10: 12, 11: 16, 12: 4, 13: 5, 14: 3, 15: 4, 16: 6, 17: 2,
}  # fmt: skip
"""Number of each camera model -> how many parameters it has."""
_COUNT, _SHORT_COUNT = struct.Struct("<Q"), struct.Struct("<I")
_POSE = 7 * 8
"""Bytes of a quaternion and a translation."""


def check_binary_model(folder: Path) -> None:
    """InputError for a binary file of the model that ends too early for its counts."""
    for name, skip in _ENTRIES.items():
        file = folder / f"{name}.bin"
        if file.is_file():
            _check(file, skip)


def _check(file: Path, skip: Callable[[mmap.mmap, int], int]) -> None:
    place = 0
    try:
        with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as m:
            (count,) = _COUNT.unpack_from(m)
            place = _COUNT.size
            for _ in range(count):  # every entry has bytes, so the file's end bounds the loop
                place = skip(m, place)
                if place > len(m):
                    raise ValueError(f"{count} entries do not fit into {len(m)} bytes")
    except (OSError, ValueError, IndexError, struct.error) as error:
        raise InputError(
            f"{file}: COLMAP cannot read this model (it is damaged near byte {place}: {error}); "
            "copy it again."
        ) from error


def _after_camera(m: mmap.mmap, place: int) -> int:
    """Identifier, number of the model, width, height, parameters."""
    model = struct.unpack_from("<i", m, place + 4)[0]
    if model not in PARAMETERS:
        raise ValueError(f"there is no camera model {model}")
    return place + 24 + 8 * PARAMETERS[model]


def _after_image(m: mmap.mmap, place: int) -> int:
    """Identifier, pose, camera, a name that ends with 0; x, y and identifier of each point."""
    end = m.find(b"\0", place + 8 + _POSE)
    if end < 0:
        raise ValueError("a name has no end")
    return end + 9 + 24 * _COUNT.unpack_from(m, end + 1)[0]


def _after_point(m: mmap.mmap, place: int) -> int:
    """Identifier, place, colour, error; image and number of each observation."""
    return place + 51 + 8 * _COUNT.unpack_from(m, place + 43)[0]


def _after_rig(m: mmap.mmap, place: int) -> int:
    """Identifier; type and identifier of each sensor, and of all but the first perhaps a pose."""
    (sensors,) = _SHORT_COUNT.unpack_from(m, place + 4)
    place += 8 + (8 if sensors else 0)
    for _ in range(1, sensors):
        place += 9 + (_POSE if m[place + 8] else 0)
    return place


def _after_frame(m: mmap.mmap, place: int) -> int:
    """Identifier, rig, pose; type, sensor and image of each datum."""
    return place + 12 + _POSE + 16 * _SHORT_COUNT.unpack_from(m, place + 8 + _POSE)[0]


_ENTRIES = {
    "cameras": _after_camera,
    "images": _after_image,
    "points3D": _after_point,
    "rigs": _after_rig,
    "frames": _after_frame,
}
"""Name of each file -> where the entry at a place ends."""
