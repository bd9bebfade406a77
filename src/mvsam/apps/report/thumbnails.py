"""Small pictures of a photo and its maps, as data that a page can carry in itself."""

import base64
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from mvsam.data.labels import ClassTable, png_palette
from mvsam.data.transforms import resize_nearest
from mvsam.inference.pictures import depth_picture
from mvsam.reconstruction.folder import open_picture

LONGEST_SIDE = 480
"""Of a thumbnail, pixels."""

UNSURE_TO_SURE = np.array(
    [[46, 22, 92], [128, 38, 120], [205, 66, 88], [245, 142, 60], [250, 232, 130]], np.float64
)
"""Colours at equal steps of confidence from 0 to 1."""


@dataclass(frozen=True)
class Thumbnail:
    """A picture as the address that holds it."""

    address: str
    width: int
    height: int


def photo_thumbnail(path: Path) -> Thumbnail:
    """The photo, smoothly reduced."""
    picture = open_picture(path)
    picture.thumbnail((LONGEST_SIDE, LONGEST_SIDE))
    return _jpeg(picture.convert("RGB"), quality=80)


def depth_thumbnail(depth: Float[np.ndarray, "height width"]) -> Thumbnail:
    """In the colours of the preview."""
    return _jpeg(Image.fromarray(depth_picture(_reduced(depth))), quality=88)


def confidence_thumbnail(confidence: UInt8[np.ndarray, "height width"]) -> Thumbnail:
    """Of 255 = 1."""
    colors = confidence_colors(_reduced(confidence) / 255)
    return _jpeg(Image.fromarray(colors), quality=88)


def label_thumbnail(labels: UInt8[np.ndarray, "height width"], classes: ClassTable) -> Thumbnail:
    picture = Image.fromarray(_reduced(labels))
    picture.putpalette(png_palette(classes))
    return _embedded(picture, "png", optimize=True)


def confidence_colors(confidence: Float[np.ndarray, "*any"]) -> UInt8[np.ndarray, "*any 3"]:
    """Colours of 0..1."""
    stops = np.linspace(0, 1, len(UNSURE_TO_SURE))
    channels = [np.interp(confidence, stops, channel) for channel in UNSURE_TO_SURE.T]
    return np.stack(channels, axis=-1).round().astype(np.uint8)


def _reduced(values: np.ndarray) -> np.ndarray:
    height, width = values.shape
    factor = min(LONGEST_SIDE / max(height, width), 1)
    return resize_nearest(values, (max(round(factor * width), 1), max(round(factor * height), 1)))


def _jpeg(picture: Image.Image, quality: int) -> Thumbnail:
    # Colours at full resolution (subsampling 0): maps have sharp edges.
    return _embedded(picture, "jpeg", quality=quality, subsampling=0)


def _embedded(picture: Image.Image, form: str, **options: int | bool) -> Thumbnail:
    file = BytesIO()
    picture.save(file, format=form, **options)
    text = base64.b64encode(file.getvalue()).decode()
    return Thumbnail(f"data:image/{form};base64,{text}", *picture.size)
