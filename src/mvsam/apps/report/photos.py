"""The photos of a `predict` folder with the maps that each has, whatever the model's tasks."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from mvsam.errors import InputError
from mvsam.geometry.depth_map import from_millimetres
from mvsam.reconstruction.folder import file_of, open_picture, read_frames


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
    photos = read_frames(folder, lambda frame: _photo(folder, frame))
    if not photos:
        raise InputError(f"{folder} holds no photos: run mvsam predict again")
    return photos


def _photo(folder: Path, frame: dict[str, Any]) -> Photo:
    file = Path(frame["file_path"])
    return Photo(
        name=Path(*file.parts[1:]).with_suffix("").as_posix(),
        color_path=folder / file,
        depth_path=file_of(folder, frame, "depth_file_path"),
        confidence_path=file_of(folder, frame, "confidence_file_path"),
        label_path=file_of(folder, frame, "label_file_path"),
    )


def read_map(path: Path) -> np.ndarray:
    """The stored numbers of a map, height x width."""
    values = np.asarray(open_picture(path))
    if values.ndim != 2:
        raise InputError(f"{path} is a colour picture, no map: run mvsam predict again")
    return values


def read_depth(path: Path) -> Float[np.ndarray, "height width"]:
    """Metres, 0 = unknown."""
    return from_millimetres(read_map(path))


def read_labels(path: Path) -> UInt8[np.ndarray, "height width"]:
    """0..K-1, `IGNORE` = unlabelled."""
    return read_map(path).astype(np.uint8)


def count_labels(labels: UInt8[np.ndarray, "height width"]) -> Int[np.ndarray, "256"]:
    """Pixels of every label value."""
    return np.bincount(labels.ravel(), minlength=256)
