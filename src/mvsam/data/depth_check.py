"""Finds out from measured depth whether the cameras were written the way we read them.

The depth of one frame, carried into another, must meet the depth measured there. Each way the files
may have been meant is tried; the one whose surfaces meet is right.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mvsam.data.frusta import Cameras, angle_preference, frustum_overlap
from mvsam.data.pose_check import AS_GIVEN, MAXIMUM_FRAMES, READINGS
from mvsam.data.registration_check import BESIDE, is_unregistered
from mvsam.data.transforms import resize_intrinsics, resize_nearest
from mvsam.errors import counted
from mvsam.types import Frame

DepthRange = tuple[float, float]
Poses = Float[np.ndarray, "camera 4 4"]

SIZE = (80, 60)
"""(width, height) at which depth is compared, pixels."""
TOLERANCE = 0.03
"""Of the depth, within which two surfaces are one."""
NUM_REFERENCES = 6
FEWEST_FRAMES = 3
FITS, FAILS = 0.5, 0.3
"""Agreement from which on cameras fit the depth, and below which nothing fits."""
LEAST_STEP, LARGEST_STEP = 0.003, 10.0
"""Metres between neighbouring frames in a recording."""
MARGIN = 0.08
"""Of agreement, by which another reading must beat the given one to be believed."""


@dataclass(frozen=True)
class Reading:
    """One way the files may have been meant; `remedy` is a sentence's end after "the cameras"."""

    remedy: str
    poses: Callable[[np.ndarray], np.ndarray] = lambda poses: poses
    size_factor: float = 1.0
    """Of the photos that the intrinsics are meant for."""
    focal_factor: float = 1.0


def _moved(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    factors = np.ones((4, 4))
    factors[:3, 3] = factor
    return lambda poses: poses * factors


def _about_the_axis(quarters: int) -> Callable[[np.ndarray], np.ndarray]:
    """Poses of cameras turned clockwise about their optical axes."""
    turn = np.eye(4)
    quarter = np.array([[0.0, 1.0], [-1.0, 0.0]])
    turn[:2, :2] = np.linalg.matrix_power(quarter, quarters)
    return lambda poses: poses @ turn


UNREGISTERED = (
    "do not belong to the depth, which is not registered to the photos but fits a depth camera of "
    "1.12 times their focal length 2 cm beside, as a Kinect's; register it"
)
HALF_SIZE = "have intrinsics for photos of half the size; double their first two rows"
DOUBLE_SIZE = "have intrinsics for photos of twice the size; halve their first two rows"
ALL_READINGS = (
    Reading(AS_GIVEN),
    *(Reading(f"are {name}", meant) for name, meant in READINGS.items() if name != AS_GIVEN),
    Reading("have translations in millimetres; divide them by 1000", _moved(1e-3)),
    Reading("have translations in kilometres; multiply them by 1000", _moved(1e3)),
    Reading(HALF_SIZE, size_factor=2.0),
    Reading(DOUBLE_SIZE, size_factor=0.5),
    Reading(
        UNREGISTERED,
        lambda poses: poses @ BESIDE.color_from_depth,
        focal_factor=BESIDE.focal_factor,
    ),
    *(
        Reading(
            f"are for photos turned by {angle} degrees; turn the photos back", _about_the_axis(n)
        )
        for n, angle in ((1, "90"), (2, "180"), (3, "270"))
    ),
)

IN_ANOTHER_UNIT = tuple(
    Reading(f"have another unit, of about {unit:g} m; give --scale", _moved(unit))
    for unit in (0.01, 0.1, 0.2, 0.3, 0.45, 0.65, 1.5, 2.2, 3.3, 5.0, 10.0)
)
"""Asked of five frames or more: by one of them, few frames meet by chance."""
FEWEST_FOR_UNITS = 5


@dataclass(frozen=True)
class Verdict:
    """What the depth says about the cameras."""

    fits: bool | None
    """None: it cannot tell."""
    sentence: str
    agreement: dict[str, float]
    """For each reading, the share of the compared pixels whose surfaces meet, 0..1."""


def depth_verdict(frames: Sequence[Frame], depth_range: DepthRange) -> Verdict:
    """The verdict of all frames with measured depth, at most 200 of them, evenly spread."""
    with_depth = [frame for frame in frames if frame.load_depth is not None]
    with_depth = with_depth[:: -(-len(with_depth) // MAXIMUM_FRAMES) or 1]
    if len(with_depth) < FEWEST_FRAMES:
        few = f"{counted(len(with_depth), 'frame')} with depth: too few to judge the cameras by."
        return Verdict(None, few, {})
    pairs = _pairs(with_depth, depth_range)
    known = ALL_READINGS + (IN_ANOTHER_UNIT if len(with_depth) >= FEWEST_FOR_UNITS else ())
    readings = [r for r in known if r.remedy == AS_GIVEN or _is_plausible(with_depth, r)]
    scores = {r.remedy: _agreement(with_depth, pairs, r) for r in readings}
    best = max(scores, key=lambda remedy: scores[remedy])
    given = scores[AS_GIVEN]
    if scores[best] < FAILS:
        sentence = f"no convention fits: at best {scores[best]:.0%} of the surfaces meet."
        return Verdict(False, f"{sentence} Are the poses those of these photos?", scores)
    if scores[best] >= FITS and scores[best] - given > MARGIN:
        sentence = f"the cameras {best} ({scores[best]:.0%} of the surfaces then meet, not "
        return Verdict(False, f"{sentence}{given:.0%}).", scores)
    if given < FITS:
        weak = (
            f"only {given:.0%} of the surfaces meet, and no other convention fits clearly better."
        )
        return Verdict(None, f"the depth does not tell whether the cameras fit: {weak}", scores)
    if is_unregistered(with_depth, pairs):
        return Verdict(False, f"the cameras {UNREGISTERED} (the photos then match better).", scores)
    others = [score for remedy, score in scores.items() if remedy != AS_GIVEN]
    sentence = f"the cameras fit the depth: {given:.0%} of the surfaces meet"
    return Verdict(True, f"{sentence} (at most {max(others):.0%} otherwise).", scores)


def _is_plausible(frames: Sequence[Frame], reading: Reading) -> bool:
    """Whether cameras then step as hands and robots do.

    Without this, dividing translations by 1000 would often fit: it leaves the rotation alone.
    """
    poses = reading.poses(np.stack([frame.world_from_cam for frame in frames]))
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    return LEAST_STEP <= float(np.median(steps)) <= LARGEST_STEP


def _pairs(frames: Sequence[Frame], depth_range: DepthRange) -> list[tuple[int, int]]:
    """Neighbours in the recording, and photos that overlap as the poses are given."""
    references = np.unique(np.linspace(0, len(frames) - 1, NUM_REFERENCES).round().astype(int))
    cameras = Cameras.of(frames)
    useful = frustum_overlap(cameras, depth_range) * angle_preference(cameras, depth_range)
    pairs = {(int(r), int(useful[r].argmax())) for r in references if useful[r].any()}
    for step in (1, 4):
        pairs |= {(int(r), int(r) + step) for r in references if r + step < len(frames)}
    return sorted(pairs)


def _agreement(
    frames: Sequence[Frame], pairs: Sequence[tuple[int, int]], reading: Reading
) -> float:
    """Mean over the better half of the pairs: others may show different things."""
    scores = []
    for pair in pairs:
        here, there = (frames[index] for index in pair)
        poses = reading.poses(np.stack([here.world_from_cam, there.world_from_cam]))
        scores.append(_meeting(here, there, poses, reading))
    better_half = sorted(scores, reverse=True)[: (len(scores) + 1) // 2]
    return float(np.mean(better_half)) if better_half else 0.0


def _meeting(here: Frame, there: Frame, poses: Poses, reading: Reading) -> float:
    """Share of `here`'s surfaces, carried into `there`, that meet the surface measured there.

    Where less than a fifth of them comes into view, a fifth is what they are a share of.
    """
    points, count = _points(here, reading)
    there_from_here = np.linalg.inv(poses[1]) @ poses[0]
    moved = points @ there_from_here[:3, :3].T + there_from_here[:3, 3]
    z = moved[:, 2]
    ahead = z > 1e-3
    projected = moved[ahead] @ _intrinsics(there, reading).T
    column, row = np.floor(projected[:, :2] / projected[:, 2:]).T
    inside = (column >= 0) & (column < SIZE[0]) & (row >= 0) & (row < SIZE[1])
    measured = _depth(there)[row[inside].astype(int), column[inside].astype(int)]
    known = measured > 0
    met = np.abs(z[ahead][inside][known] - measured[known]) < TOLERANCE * measured[known]
    return float(met.sum() / max(known.sum(), 0.2 * count, 1))


def _points(frame: Frame, reading: Reading) -> tuple[np.ndarray, int]:
    """Surface points in camera axes, and how many there are."""
    depth = _depth(frame)
    rows, columns = np.nonzero(depth > 0)
    pixels = np.column_stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
    rays = pixels @ np.linalg.inv(_intrinsics(frame, reading)).T
    return rays * depth[rows, columns, None], len(rows)


def _intrinsics(frame: Frame, reading: Reading) -> np.ndarray:
    size, focal = reading.size_factor, reading.focal_factor
    small = resize_intrinsics(frame.intrinsics, frame.size, SIZE) * [[size], [size], [1.0]]
    return small * [[focal, 1, 1], [1, focal, 1], [1, 1, 1]]


def _depth(frame: Frame) -> np.ndarray:
    depth = frame.depth
    assert depth is not None
    return resize_nearest(depth, SIZE).astype(np.float64)
