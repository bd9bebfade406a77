"""The photos of a `predict` folder with the maps that each has, whatever the model's tasks."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image, UnidentifiedImageError

from mvsam.errors import InputError
from mvsam.geometry.depth_map import from_millimetres

Item = TypeVar("Item")


@dataclass(frozen=True)
class Photo:
    """Where a photo and its maps lie; None for a task that the model does not have."""

    name: str
    color_path: Path
    depth_path: Path | None
    confidence_path: Path | None
    label_path: Path | None


def read_photos(folder: Path) -> list[Photo]:
    """All photos of a `predict` folder; `InputError` where it is not one, or is damaged."""
    path = folder / "transforms.json"
    if not path.is_file():
        raise InputError(f"{folder} has no transforms.json: give the --out folder of mvsam predict")
    try:
        photos = [_photo(folder, frame) for frame in json.loads(path.read_text())["frames"]]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is damaged ({error!r}): run mvsam predict again") from error
    if not photos:
        raise InputError(f"{folder} holds no photos: run mvsam predict again")
    return photos


def _photo(folder: Path, frame: dict[str, Any]) -> Photo:
    def beside(key: str) -> Path | None:
        return folder / frame[key] if key in frame else None

    file = Path(frame["file_path"])
    return Photo(
        name=Path(*file.parts[1:]).with_suffix("").as_posix(),
        color_path=folder / file,
        depth_path=beside("depth_file_path"),
        confidence_path=beside("confidence_file_path"),
        label_path=beside("label_file_path"),
    )


def open_picture(path: Path) -> Image.Image:
    """A photo or map, not decoded yet; `InputError` where it is none."""
    try:
        return Image.open(path, formats=("PNG", "JPEG"))
    except (OSError, UnidentifiedImageError) as error:
        raise InputError(f"{path} cannot be read: run mvsam predict again") from error


def read_map(path: Path) -> np.ndarray:
    """The stored numbers of a map, height x width."""
    try:
        with open_picture(path) as picture:
            return np.asarray(picture)
    except OSError as error:
        raise InputError(f"{path} cannot be read: run mvsam predict again") from error


def read_depth(path: Path) -> Float[np.ndarray, "height width"]:
    """Metres, 0 = unknown."""
    return from_millimetres(read_map(path))


def read_labels(path: Path) -> UInt8[np.ndarray, "height width"]:
    """0..K-1, `IGNORE` = unlabelled."""
    return read_map(path).astype(np.uint8)


def count_labels(labels: UInt8[np.ndarray, "height width"]) -> Int[np.ndarray, "256"]:
    """Pixels of every label value."""
    return np.bincount(labels.ravel(), minlength=256)


def evenly(items: Sequence[Item], most: int) -> list[Item]:
    """At most so many of them, the first and the last among them, at even distances."""
    if len(items) <= most:
        return list(items)
    places = np.linspace(0, len(items) - 1, most).round().astype(int)
    return [items[place] for place in places]
