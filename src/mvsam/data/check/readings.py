"""The ways in which a scene's cameras may have been meant, each with the remedy."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mvsam.data.check.poses import AS_GIVEN, READINGS
from mvsam.data.check.registration import BESIDE

PoseChange = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Reading:
    """One way the files may have been meant; `remedy` is a sentence's end after "the cameras"."""

    remedy: str
    poses: PoseChange = lambda poses: poses
    size_factor: float = 1.0
    """Of the photos that the intrinsics are meant for."""
    focal_factor: float = 1.0


def _moved(factor: float) -> PoseChange:
    factors = np.ones((4, 4))
    factors[:3, 3] = factor
    return lambda poses: poses * factors


def _about_the_axis(quarters: int) -> PoseChange:
    """Poses of cameras turned clockwise about their optical axes."""
    turn = np.eye(4)
    quarter = np.array([[0.0, 1.0], [-1.0, 0.0]])
    turn[:2, :2] = np.linalg.matrix_power(quarter, quarters)
    return lambda poses: poses @ turn


def _of_another_size(factor: float) -> Reading:
    remedy = (
        f"have intrinsics for photos of about {1 / factor:.2g} times the size; "
        f"multiply their first two rows by {factor:.2g}"
    )
    return Reading(remedy, size_factor=factor)


GIVEN = Reading(AS_GIVEN)
OTHER_POSES = tuple(
    Reading(f"are {name}", meant) for name, meant in READINGS.items() if name != AS_GIVEN
)
IN_THOUSANDS = (
    Reading("have translations in millimetres; divide them by 1000", _moved(1e-3)),
    Reading("have translations in kilometres; multiply them by 1000", _moved(1e3)),
)
HALF_SIZE = "have intrinsics for photos of half the size; double their first two rows"
DOUBLE_SIZE = "have intrinsics for photos of twice the size; halve their first two rows"
OTHER_SIZES = (
    Reading(HALF_SIZE, size_factor=2.0),
    Reading(DOUBLE_SIZE, size_factor=0.5),
    *(_of_another_size(factor) for factor in (1 / 4, 1 / 3, 2 / 3, 0.8, 1.25, 1.5, 3.0, 4.0)),
)
UNREGISTERED = (
    "do not belong to the depth, which is not registered to the photos but fits a depth camera of "
    "1.12 times their focal length 2 cm beside, as a Kinect's; register it"
)
DEPTH_FROM_BESIDE = Reading(
    UNREGISTERED, lambda poses: poses @ BESIDE.color_from_depth, focal_factor=BESIDE.focal_factor
)
TURNED_PHOTOS = tuple(
    Reading(f"are for photos turned by {90 * n} degrees; turn the photos back", _about_the_axis(n))
    for n in (1, 2, 3)
)
ALL_READINGS = (
    GIVEN,
    *OTHER_POSES,
    *IN_THOUSANDS,
    *OTHER_SIZES,
    DEPTH_FROM_BESIDE,
    *TURNED_PHOTOS,
)
UNIT_REACH = 1.5
"""Factor up to which a unit is measured, around one of the few that are tried first: the latter are
about so far apart where poses are likely to be."""


def in_unit(metres: float) -> Reading:
    """As it would be if a unit of the poses were so long."""
    length = f"of about {metres:.3g} m if the depth's is right"
    return Reading(f"have another unit than the depth, {length}; give --scale", _moved(metres))


IN_ANOTHER_UNIT = {
    unit: in_unit(unit) for unit in (0.01, 0.1, 0.2, 0.3, 0.45, 0.65, 1.5, 2.2, 3.3, 5.0, 10.0)
}
"""By their length in metres. Asked of five frames or more: by one of them, few meet by chance."""
