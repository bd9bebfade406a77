"""How seconds and memory grow with the views, the planes and the size of the pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from mvsam.apps.bench.cases import Case

Axis = Literal["views", "planes", "megapixels"]


def cases_along(base: Case) -> dict[Axis, list[tuple[float, Case]]]:
    """Axis -> (place on it, case), everything else as in `base`.

    planes: those of the coarsest stage; the finer stages keep their share of 2/3 and 1/3, so that
    the work of every stage grows alike. megapixels: of one picture.
    """
    sizes = ((160, 128), (320, 256), (480, 384), (640, 512))
    return {
        "views": [(float(n), replace(base, num_views=n)) for n in (2, 3, 4, 6, 8)],
        "planes": [
            (24.0 * k, replace(base, num_planes=(24 * k, 16 * k, 8 * k))) for k in (1, 2, 3, 4)
        ],
        "megapixels": [
            (width * height / 1e6, replace(base, width=width, height=height))
            for width, height in sizes
        ],
    }


@dataclass(frozen=True)
class Line:
    """The straight line nearest to some points, by squares."""

    intercept: float
    slope: float
    largest_deviation: float
    """Of any point from the line, as a share of the point's own value."""


def fit_line(places: Sequence[float], values: Sequence[float]) -> Line:
    """How linear the growth is."""
    slope, intercept = np.polyfit(places, values, 1)
    expected = intercept + slope * np.asarray(places)
    deviation = np.abs(expected - values) / np.abs(values)
    return Line(float(intercept), float(slope), float(deviation.max()))
