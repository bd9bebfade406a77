"""Lists of scenes and of view tuples that come as files: ScanNet's splits, MVS2D's triplets."""

import io
import pickle
import pickletools
import re
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from mvsam.errors import InputError

SCAN_FOLDERS = ("", "scans", "scans_test", "../scans", "../scans_test")
"""Where scans lie, seen from the folder of their list."""
_LARGEST_FILE = 256 * 2**20
_MOST_SOURCES = 1000

TuplesByScene = dict[str, list[tuple[int, ...]]]
"""Scene -> frame numbers of each tuple: the reference, then its sources."""


def is_scene_list(name: str) -> bool:
    """Whether data are named by a list of scenes, as scannetv2_val.txt."""
    return name.endswith(".txt")


def listed_scenes(file: Path) -> list[Path]:
    """The folders of the scenes in a list, one name a line; all must be there."""
    if not file.is_file():
        official = re.fullmatch(r"scannetv2_(train|val|test)\.txt", file.name)
        advice = (
            "ScanNet's own repository has it, github.com/ScanNet/ScanNet, in Tasks/Benchmark; put "
            "it beside the scans"
            if official
            else "write one with a scene's name a line, beside the scenes"
        )
        raise InputError(f"{file}: there is no such list; {advice}.")
    try:
        names = file.read_text(encoding="utf-8-sig").split()
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read ({error}).") from error
    if not names or any(not re.fullmatch(r"[\w.-]+", name) or name == ".." for name in names):
        raise InputError(f"{file}: expected one scene's name a line, as scene0011_00.")
    places = [file.parent / place for place in SCAN_FOLDERS]
    found = {name: next((p / name for p in places if (p / name).is_dir()), None) for name in names}
    if missing := [name for name, folder in found.items() if folder is None]:
        raise InputError(
            f"{file}: {len(missing)} of its {len(found)} scenes are not beside it or in scans/, "
            f"{missing[0]} first; download them or remove their lines."
        )
    return [folder for folder in found.values() if folder is not None]


def read_tuples(file: Path) -> TuplesByScene:
    """View tuples by scene from MVS2D's `ScanNet_3_frame_*.npy`, or from text.

    A line of text is a scene's name, the reference's frame number and those of its sources.
    """
    if not file.is_file():
        raise InputError(
            f"{file}: there is no such file; MVS2D's authors share their split files on OneDrive "
            "(see the README of zhenpeiyang/MVS2D)."
        )
    entries = _npy_entries(file) if file.suffix == ".npy" else _text_entries(file)
    tuples: TuplesByScene = {}
    for number, (scene, frames) in enumerate(entries):
        if len(frames) < 2 or len(set(frames)) < len(frames) or min(frames) < 0:
            raise InputError(f"{file} entry {number}: {frames} are no reference with sources.")
        tuples.setdefault(scene, []).append(tuple(frames))
    if not tuples:
        raise InputError(f"{file}: holds no view tuple.")
    return tuples


def _text_entries(file: Path) -> Iterable[tuple[str, list[int]]]:
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read ({error}).") from error
    entries = []
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if not all(re.fullmatch(r"[0-9]{1,9}", word) for word in words[1:]):
            raise InputError(f"{file} line {number}: expected 'scene reference source ...'.")
        entries.append((words[0], [int(word) for word in words[1:]]))
    return entries


def _npy_entries(file: Path) -> Iterable[tuple[str, list[int]]]:
    """A list of dictionaries `scene`, `target`, `refs`, as numpy pickles it."""
    try:
        if (size := file.stat().st_size) > _LARGEST_FILE:
            raise ValueError(f"{size} bytes are too many for a list")
        return [_entry(value) for value in _read_objects(file.read_bytes())]
    except Exception as error:  # a damaged pickle raises almost anything
        raise InputError(
            f"{file}: expected MVS2D's list of 'scene', 'target' and 'refs' ({error}); copy it "
            "again."
        ) from error


def _entry(value: Any) -> tuple[str, list[int]]:
    """Strict, because one list may stand in a pickle at many places, and within itself."""
    scene, sources = value["scene"], list(islice(value["refs"], _MOST_SOURCES + 1))
    if not isinstance(scene, str) or len(sources) > _MOST_SOURCES:
        raise ValueError(f"a {type(scene).__name__} as scene with {len(sources)} sources")
    return str(scene), [int(value["target"]), *(int(number) for number in sources)]


def _read_objects(content: bytes) -> list[Any]:
    """The objects of a .npy file, without running what a stranger may have put into it."""
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    if version != (1, 0):
        raise ValueError(f"version {version}")
    _, _, dtype = np.lib.format.read_array_header_1_0(stream)
    if not dtype.hasobject:
        raise ValueError(f"numbers of type {dtype}, no list of objects")
    pickled = io.BytesIO(_unframed(content[stream.tell() :]))
    return list(_NumpyAlone(pickled, encoding="latin1").load())


def _unframed(pickled: bytes) -> bytes:
    """The same pickle without frames; ValueError where it would take more memory than it is long.

    The unpickler takes memory for a frame or a memo before it knows that there is so much. And a
    frame within a frame makes it skip bytes, so that it would not read what is checked here.
    """
    parts, start = [], 0
    for opcode, argument, place in pickletools.genops(pickled):  # which refuses short strings
        if opcode.name == "FRAME":
            parts.append(pickled[start:place])
            start = (place or 0) + 9
        elif opcode.name.endswith("PUT") and not 0 <= int(argument or 0) <= len(pickled):
            raise ValueError(f"{opcode.name} of {argument} in {len(pickled)} bytes")
    return b"".join([*parts, pickled[start:]])


class _Kind:
    """A plain `numpy.dtype`; that of NumPy itself crashes for some states."""

    def __init__(self, code: str, *_: Any):
        if not re.fullmatch(r"[?biufOSU][0-9]{0,3}", code):
            raise ValueError(f"numbers of type {code}")
        self.code, self.order = code, "="

    def __setstate__(self, state: Any) -> None:
        self.order = str(state[1])

    def read(self, data: bytes | str, count: int) -> np.ndarray:
        """The first so many numbers; old pickles hold bytes as text, a byte a character."""
        kind = np.dtype(self.order + self.code)
        data = data[: count * kind.itemsize]
        return np.frombuffer(data.encode("latin1") if isinstance(data, str) else data, kind)


class _Array:
    """The numbers of a `numpy.ndarray`, read when they are asked for, or its list of objects."""

    def __init__(self, *_: Any):
        self.kind = _Kind("O")
        self.values: Any = []

    def __setstate__(self, state: Any) -> None:
        _, _, self.kind, _, self.values = state

    def __iter__(self) -> Iterator[Any]:
        if self.kind.code.startswith("O"):
            return iter(self.values)
        return iter(self.kind.read(self.values, _MOST_SOURCES + 1))


def _number(kind: _Kind, value: bytes | str) -> np.generic:
    return kind.read(value, 1)[0]


def _as_it_is(text: str, _: str) -> str:
    return text


class _NumpyAlone(pickle.Unpickler):
    """Knows NumPy's arrays and numbers, each in a form that takes no more memory than the file."""

    known: ClassVar[dict[str, Any]] = {
        "numpy.ndarray": None,  # which `_reconstruct` is always told to make
        "numpy.dtype": _Kind,
        "numpy.core.multiarray._reconstruct": _Array,
        "numpy.core.multiarray.scalar": _number,
        "_codecs.encode": _as_it_is,
    }

    def find_class(self, module_name: str, global_name: str) -> Any:
        name = f"{module_name.replace('numpy._core', 'numpy.core')}.{global_name}"
        if name not in self.known:
            raise pickle.UnpicklingError(f"it wants to call {module_name}.{global_name}")
        return self.known[name]
