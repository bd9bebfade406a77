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
from mvsam.types import IGNORE

Item = TypeVar("Item")


@dataclass(frozen=True)
class DepthView:
    """One photo of a `predict` folder; maps are read when asked for."""

    size: tuple[int, int]
    """(width, height) of the thinned maps."""
    step: int
    """Every step-th pixel of the photo is kept."""
    intrinsics: Float[np.ndarray, "3 3"]
    """Pixels of the thinned maps, corner convention."""
    world_from_cam: Float[np.ndarray, "4 4"]
    """Metres, OpenCV axes."""
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
        return _middle_pixels(pixels, self.step, self.size)


def _middle_pixels(pixels: np.ndarray, step: int, size: tuple[int, int]) -> np.ndarray:
    """The middle pixel of each step x step block; its centre is the block's for odd steps."""
    width, height = size
    return pixels[step // 2 :: step, step // 2 :: step][:height, :width]


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
    width, height = frame["w"], frame["h"]
    step = -(-max(width, height) // longest_side)
    # The kept pixel's centre (step // 2 + 0.5) must land on (0.5, 0.5) of the thinned map.
    shift = 0.5 - (step // 2 + 0.5) / step
    intrinsics = np.array(
        [
            [frame["fl_x"] / step, 0.0, frame["cx"] / step + shift],
            [0.0, frame["fl_y"] / step, frame["cy"] / step + shift],
            [0.0, 0.0, 1.0],
        ]
    )
    return DepthView(
        size=(max(width // step, 1), max(height // step, 1)),
        step=step,
        intrinsics=intrinsics,
        world_from_cam=np.array(frame["transform_matrix"], np.float64) @ OPENCV_FROM_OPENGL,
        photo_path=folder / frame["file_path"],
        depth_path=folder / frame["depth_file_path"],
        confidence_path=file_of(folder, frame, "confidence_file_path"),
        label_path=file_of(folder, frame, "label_file_path"),
    )
