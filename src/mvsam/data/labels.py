"""Class names and colours: ScanNet's 20 benchmark classes, and tables a user's folder brings."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from mvsam.errors import InputError
from mvsam.types import IGNORE, Model

Color = tuple[int, int, int]
UNLABELLED_COLOR: Color = (0, 0, 0)


@dataclass(frozen=True)
class ClassTable:
    """What the label values 0..K-1 stand for."""

    names: tuple[str, ...]
    colors: tuple[Color, ...]
    """RGB, 0..255."""

    def __len__(self) -> int:
        return len(self.names)

    def __post_init__(self):
        if len(self.names) != len(self.colors):
            raise ValueError(f"{len(self.names)} class names but {len(self.colors)} colours")
        if not 1 <= len(self.names) <= IGNORE:
            raise ValueError(f"a class table holds 1 to {IGNORE} classes, not {len(self.names)}")


SCANNET20 = ClassTable(
    names=(
        "wall",
        "floor",
        "cabinet",
        "bed",
        "chair",
        "sofa",
        "table",
        "door",
        "window",
        "bookshelf",
        "picture",
        "counter",
        "desk",
        "curtain",
        "refrigerator",
        "shower curtain",
        "toilet",
        "sink",
        "bathtub",
        "otherfurniture",
    ),
    colors=(
        (174, 199, 232),
        (152, 223, 138),
        (31, 119, 180),
        (255, 187, 120),
        (188, 189, 34),
        (140, 86, 75),
        (255, 152, 150),
        (214, 39, 40),
        (197, 176, 213),
        (148, 103, 189),
        (196, 156, 148),
        (23, 190, 207),
        (247, 182, 210),
        (219, 219, 141),
        (255, 127, 14),
        (158, 218, 229),
        (44, 160, 44),
        (112, 128, 144),
        (227, 119, 194),
        (82, 84, 163),
    ),
)
"""The 20 classes in the order of the ScanNet benchmark, in its colours."""


def classes_of_model(model: Model) -> ClassTable:
    """The classes that the model's weights were trained for."""
    info = model.info
    return ClassTable(info.classes, info.palette) if info and info.classes else SCANNET20


def lookup_table(classes: ClassTable) -> UInt8[np.ndarray, "256 3"]:
    """RGB of every possible label value; black where a value names no class."""
    table = np.full((256, 3), UNLABELLED_COLOR, np.uint8)
    table[: len(classes)] = classes.colors
    return table


def colorize(
    labels: UInt8[np.ndarray, "height width"], classes: ClassTable = SCANNET20
) -> UInt8[np.ndarray, "height width 3"]:
    """RGB picture of a label map; unlabelled pixels are black."""
    return lookup_table(classes)[labels]


def png_palette(classes: ClassTable = SCANNET20) -> list[int]:
    """The 768 numbers for `PIL.Image.putpalette`; index 255 (unlabelled) is black."""
    return lookup_table(classes).flatten().tolist()


def read_class_table(path: Path) -> ClassTable:
    """The table in a `classes.json`: a list of objects with `name` and `color` ([r, g, b])."""
    expected = 'expected a list like [{"name": "wall", "color": [174, 199, 232]}, ...]'
    try:
        entries = json.loads(path.read_text(encoding="utf-8-sig"))
        names = tuple(_class_name(entry["name"]) for entry in entries)
        return ClassTable(names, tuple(_color(entry["color"]) for entry in entries))
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{path}: not a class table ({error}); {expected}.") from error


def _class_name(value: object) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError(f"name {value!r} is not a text")
    return value


def _color(value: object) -> Color:
    match value:
        case [int(red), int(green), int(blue)] if all(0 <= v <= 255 for v in (red, green, blue)):
            return red, green, blue
    raise ValueError(f"color {value!r} is not three numbers from 0 to 255")
