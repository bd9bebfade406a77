"""nerfstudio's `transforms.json`: OpenGL axes, intrinsics once or a frame, lenses undistorted.

Pixel centres lie at halves, as COLMAP's do, so nothing is added to the principal point. Our own
`predict` writes this format too, with `label_file_path`, `confidence_file_path` and `classes.json`
besides, and `is_predicted`: such maps are no truth, so photos and cameras alone are read.
"""

import json
import logging
import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mvsam.data.camera_checks import check_depth_scale, check_pose
from mvsam.data.files import check_map, check_photo, is_file, load_depth, load_labels, load_photo
from mvsam.data.readers.listed import ListedScene, checked, corner_intrinsics, file_inside
from mvsam.data.readers.posed_folder import read_classes
from mvsam.data.readers.undistort import Distortion, undistort
from mvsam.errors import InputError, counted
from mvsam.geometry.pose import OPENCV_FROM_OPENGL
from mvsam.types import IGNORE, Frame

FILE = "transforms.json"
_PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
_LENSES = ("OPENCV", "RADIAL", "SIMPLE_RADIAL")
_FISHEYES = ("OPENCV_FISHEYE",)
_SUFFIXES = ("", ".png", ".jpg", ".jpeg")
"""Blender's files leave the ending out."""

log = logging.getLogger("mvsam")


def is_nerfstudio(path: Path) -> bool:
    return (path / FILE).is_file()


def open_nerfstudio(path: Path) -> ListedScene:
    """The scene of a folder with a `transforms.json`; raises `InputError` for a broken one."""
    file = path / FILE
    content = _read(file)
    entries = content.get("frames")
    if not isinstance(entries, list):
        raise InputError(f"{file}: has no list of frames; write it under the key 'frames'.")
    names, classes = _names(entries, file), read_classes(path)
    listed = list(zip(entries, names, range(len(entries)), strict=True))
    tracked = [(entry, name, index) for entry, name, index in listed if not _is_lost(entry)]
    entries = [entry for entry, _, _ in tracked]
    frames = [
        _frame(path, content, entry, name, len(classes), f"{file} frame {index}")
        for entry, name, index in tracked
    ]
    _check_one_size(file, content, entries, frames)
    bent = sum(not _distortion({**content, **entry}, str(file)).is_none for entry in entries)
    if bent:
        log.info("%s: %s undistorted while read.", file, counted(bent, "picture"))
    is_from_colmap = any("colmap_im_id" in entry for entry in entries)
    return ListedScene(
        path.resolve().name,
        frames,
        classes=classes,
        num_lost=len(listed) - len(frames),
        has_unit=not is_from_colmap,
    )


def _read(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{file}: cannot be read as JSON ({error}).") from error
    if not isinstance(content, dict):
        raise InputError(f"{file}: holds no JSON object; see docs/data.md for an example.")
    return content


def _names(entries: list, file: Path) -> list[str]:
    """Stems of the pictures, or their whole paths where stems are not unique."""
    paths = []
    for index, entry in enumerate(entries):
        item = f"{file} frame {index}"
        path = entry.get("file_path") if isinstance(entry, dict) else None
        if not isinstance(path, str) or not path:
            raise InputError(f"{item}: has no 'file_path' of a picture.")
        file_inside(file.parent, path, item)
        paths.append(path)
    stems = [Path(path).stem for path in paths]
    if len(set(stems)) == len(stems):
        return stems
    return [str(Path(path).with_suffix("")).strip("./").replace("/", "_") for path in paths]


def _check_one_size(file: Path, content: dict, entries: list, frames: list[Frame]) -> None:
    """Raise where photos of two sizes share a focal length in pixels that is of no stated size."""
    focal, size = {"fl_x", "fl_y"}, {"w", "h"}
    if not focal & content.keys() or size & content.keys():
        return
    pairs = zip(entries, frames, strict=True)
    sharing = [frame for entry, frame in pairs if not (focal | size) & entry.keys()]
    other = next((frame for frame in sharing if frame.size != sharing[0].size), None)
    if other:
        both = " and ".join(f"{f.name} ({f.size[0]}x{f.size[1]})" for f in (sharing[0], other))
        raise InputError(
            f"{file}: photos {both} differ in size but share 'fl_x'; write the 'w' and 'h' that it "
            "was calibrated for beside it, or each photo's own in its frame."
        )


def _frame(path: Path, content: dict, entry: dict, name: str, num_classes: int, item: str) -> Frame:
    photo = _existing(path, entry["file_path"], item)
    size = check_photo(photo)
    intrinsics = _intrinsics({**content, **entry}, size, item)
    distortion = _distortion({**content, **entry}, item)
    pixels = {"intrinsics": intrinsics, "distortion": distortion}
    is_measured = not content.get("is_predicted", False)
    depth = _map(path, entry, "depth", size, item) if is_measured else None
    labels = _map(path, entry, "label", size, item) if is_measured else None
    scale = _number({**content, **entry}, "depth_unit_scale_factor", item, default=1e-3)
    check_depth_scale(scale, f"{item}, depth_unit_scale_factor")
    frame = Frame(
        name=name,
        size=size,
        intrinsics=intrinsics,
        world_from_cam=_matrix(entry, item) @ OPENCV_FROM_OPENGL,
        load_image=partial(_load_photo, photo, **pixels),
        load_depth=partial(_load_depth, depth, scale, **pixels) if depth else None,
        load_labels=partial(_load_labels, labels, num_classes, **pixels) if labels else None,
    )
    return checked(frame, item)


def _existing(path: Path, relative: object, item: str) -> Path:
    wanted = file_inside(path, relative, item)
    for suffix in _SUFFIXES:
        candidate = wanted.with_name(wanted.name + suffix)
        if is_file(candidate):
            return candidate
    raise InputError(f"{item}: there is no picture {wanted}; put it back or remove the frame.")


def _map(path: Path, entry: dict, kind: str, size: tuple[int, int], item: str) -> Path | None:
    relative = entry.get(f"{kind}_file_path")
    if relative is None:
        return None
    file = file_inside(path, relative, item)
    if not is_file(file):
        raise InputError(f"{item}: there is no {kind} map {file}; put it back or remove its key.")
    check_map(file, kind, size)
    return file


def _is_lost(entry: dict) -> bool:
    """Whether its pose is one, but of numbers that are not finite, as where tracking was lost."""
    try:
        matrix = np.array(entry.get("transform_matrix"), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return False
    return matrix.shape in ((3, 4), (4, 4)) and not np.isfinite(matrix).all()


def _matrix(entry: dict, item: str) -> np.ndarray:
    """Camera to world, OpenGL axes."""
    try:
        matrix = np.array(entry.get("transform_matrix"), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0, 0, 0, 1]])
    if matrix.shape != (4, 4):
        raise InputError(f"{item}: 'transform_matrix' is not 4x4; write camera to world.")
    check_pose(matrix, item)  # before it is multiplied: infinity times 0 is a warning of NumPy's
    return matrix


def _intrinsics(values: dict, size: tuple[int, int], item: str) -> np.ndarray:
    """Of a photo of this size, scaled if `w` and `h` are those of another."""
    width, height = size
    given = _number(values, "w", item, width), _number(values, "h", item, height)
    if min(given) <= 0 or abs(given[0] * height - given[1] * width) > max(width, height):
        raise InputError(
            f"{item}: calibrated for {given[0]:g}x{given[1]:g}, but the picture is "
            f"{width}x{height}, another shape; calibrate the pictures as they are."
        )
    if "fl_x" in values or "fl_y" in values:
        fx = _number(values, "fl_x" if "fl_x" in values else "fl_y", item)
        fy = _number(values, "fl_y", item, default=fx)
    elif "camera_angle_x" in values:
        angle = _number(values, "camera_angle_x", item)
        if not 0 < angle < math.pi:
            raise InputError(f"{item}: camera_angle_x is {angle:g}, not an angle in radians.")
        fx = fy = 0.5 * given[0] / math.tan(0.5 * angle)
    else:
        raise InputError(f"{item}: neither 'fl_x' nor 'camera_angle_x' tells the focal length.")
    cx = _number(values, "cx", item, default=given[0] / 2)
    cy = _number(values, "cy", item, default=given[1] / 2)
    matrix = corner_intrinsics(fx, fy, cx, cy, has_integer_centres=False)
    return matrix * np.array([[width / given[0]], [height / given[1]], [1.0]])


def _distortion(values: dict, item: str) -> Distortion:
    model = values.get("camera_model", "OPENCV")
    if model in _PINHOLES:
        return Distortion()
    radial = tuple(_number(values, f"k{i}", item, default=0.0) for i in (1, 2, 3, 4))
    if model in _FISHEYES:
        return Distortion("fisheye", radial)
    if model not in _LENSES:
        raise InputError(
            f"{item}: camera model {model!r} is not supported; choose one of "
            f"{', '.join((*_PINHOLES, *_LENSES, *_FISHEYES))}, or undistort the pictures."
        )
    tangential = _number(values, "p1", item, default=0.0), _number(values, "p2", item, default=0.0)
    return Distortion("brown", radial, tangential)


def _number(values: dict, key: str, item: str, default: float | int | None = None) -> float:
    value = values.get(key, default)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or abs(value) > 1e12 or not math.isfinite(value):
        raise InputError(f"{item}: '{key}' is {value!r}, not a number.")
    return float(value)


def _load_photo(file: Path, intrinsics: np.ndarray, distortion: Distortion) -> np.ndarray:
    photo = load_photo(file)
    return photo if distortion.is_none else undistort(photo, intrinsics, distortion)


def _load_depth(
    file: Path, scale: float, intrinsics: np.ndarray, distortion: Distortion
) -> np.ndarray:
    depth = load_depth(file) * np.float32(scale / 1e-3)
    return depth if distortion.is_none else undistort(depth, intrinsics, distortion, outside=0)


def _load_labels(
    file: Path, num_classes: int, intrinsics: np.ndarray, distortion: Distortion
) -> np.ndarray:
    labels = load_labels(file, num_classes)
    return labels if distortion.is_none else undistort(labels, intrinsics, distortion, IGNORE)
