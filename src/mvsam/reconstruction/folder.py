"""The output folder of `mvsam predict`, read back: cameras and maps, photo by photo.

All maps of a photo are thinned by one whole-number step, so that its longer side stays below a
limit; a labelled cloud of centimetre voxels does not need every pixel of a 12-megapixel photo.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, UnidentifiedImageError

from mvsam.errors import InputError
from mvsam.geometry.depth_map import from_millimetres
from mvsam.geometry.pose import OPENCV_FROM_OPENGL
from mvsam.reconstruction.thinning import ThinnedCamera, thin
from mvsam.types import IGNORE

Item = TypeVar("Item")


@dataclass(frozen=True)
class DepthView(ThinnedCamera):
    """One photo of a `predict` folder; maps are read when asked for."""

    photo_path: Path
    depth_path: Path
    confidence_path: Path | None
    label_path: Path | None

    def depth(self) -> Float[np.ndarray, "height width"]:
        """Metres, 0 = unknown."""
        return from_millimetres(self._thinned(self.depth_path))

    def confidence(self) -> Float[np.ndarray, "height width"]:
        """0..1; one where the model gives none."""
        if self.confidence_path is None:
            return np.ones(self.size[::-1], np.float32)
        return self._thinned(self.confidence_path).astype(np.float32) / 255

    def labels(self) -> UInt8[np.ndarray, "height width"]:
        """0..K-1; `IGNORE` everywhere where the model gives none."""
        if self.label_path is None:
            return np.full(self.size[::-1], IGNORE, np.uint8)
        return self._thinned(self.label_path)

    def photo(self) -> UInt8[np.ndarray, "height width 3"]:
        """RGB."""
        return self._thinned(self.photo_path)

    def palette(self) -> UInt8[np.ndarray, "256 3"]:
        """Colour of each label, as the label picture carries it; black where there is none."""
        colors = np.zeros((256, 3), np.uint8)
        if self.label_path is not None:
            stored = open_picture(self.label_path).getpalette() or []
            colors[: len(stored) // 3] = np.reshape(stored, (-1, 3))
        return colors

    def _thinned(self, path: Path) -> np.ndarray:
        pixels = np.asarray(open_picture(path))
        if pixels.shape[0] < self.size[1] or pixels.shape[1] < self.size[0]:
            raise InputError(
                f"{path} is smaller than transforms.json says: run mvsam predict again"
            )
        return self.thinned(pixels)


def open_picture(path: Path) -> Image.Image:
    """A photo or a map; `InputError` where it cannot be read."""
    try:
        image = Image.open(path, formats=("PNG", "JPEG"))
        image.load()
    except (OSError, UnidentifiedImageError) as error:
        raise InputError(f"{path} cannot be read: run mvsam predict again") from error
    return image


def read_predictions(folder: Path, longest_side: int = 640) -> list[DepthView]:
    """The photos of a `predict` folder that have a depth map.

    Raises `InputError` where the folder is not one, or holds no depth.
    """

    def read(frame: dict[str, Any]) -> DepthView | None:
        return _view(folder, frame, longest_side) if "depth_file_path" in frame else None

    views = [view for view in read_frames(folder, read) if view is not None]
    if not views:
        raise InputError(f"{folder} holds no depth maps: predict with a model that gives depth")
    return views


def read_frames(folder: Path, read: Callable[[dict[str, Any]], Item]) -> list[Item]:
    """What `read` makes of each photo's entry in `transforms.json`.

    Raises `InputError` where there is no such file, or an entry lacks what `read` wants of it.
    """
    path = folder / "transforms.json"
    if not path.is_file():
        missing = "has no transforms.json" if folder.is_dir() else "is no folder"
        raise InputError(f"{folder} {missing}: give the --out folder of mvsam predict")
    try:
        return [read(frame) for frame in json.loads(path.read_text())["frames"]]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is damaged ({error!r}): run mvsam predict again") from error


def file_of(folder: Path, frame: dict[str, Any], key: str) -> Path | None:
    """Where a map of a photo lies; None where the model gives none."""
    return folder / frame[key] if key in frame else None


def _view(folder: Path, frame: dict[str, Any], longest_side: int) -> DepthView:
    intrinsics = np.array(
        [[frame["fl_x"], 0.0, frame["cx"]], [0.0, frame["fl_y"], frame["cy"]], [0.0, 0.0, 1.0]]
    )
    world_from_cam = np.array(frame["transform_matrix"], np.float64) @ OPENCV_FROM_OPENGL
    camera = thin((frame["w"], frame["h"]), intrinsics, world_from_cam, longest_side)
    return DepthView(
        **vars(camera),
        photo_path=folder / frame["file_path"],
        depth_path=folder / frame["depth_file_path"],
        confidence_path=file_of(folder, frame, "confidence_file_path"),
        label_path=file_of(folder, frame, "label_file_path"),
    )
