"""Finds out from measured depth whether the cameras were written the way we read them.

The depth of one frame, carried into another, must meet the depth measured there. Each way the files
may have been meant is tried; the one whose surfaces meet is right.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from mvsam.data.check.poses import AS_GIVEN, MAXIMUM_FRAMES
from mvsam.data.check.readings import (
    ALL_READINGS,
    GIVEN,
    IN_ANOTHER_UNIT,
    OTHER_POSES,
    UNIT_REACH,
    UNREGISTERED,
    Reading,
    in_unit,
)
from mvsam.data.check.registration import is_unregistered
from mvsam.data.depth_range import DepthRange
from mvsam.data.frusta import Cameras, angle_preference, frustum_overlap
from mvsam.data.transforms import resize_intrinsics, resize_nearest
from mvsam.errors import counted
from mvsam.geometry.points import moved, to_pixels, viewing_rays
from mvsam.types import Frame

SIZE = (80, 60)
"""(width, height) at which depth is compared, pixels."""
TOLERANCE = 0.03
"""Of the depth, within which two surfaces are one."""
NUM_REFERENCES = 6
FEWEST_FRAMES = 3
FEWEST_TO_BE_SURE = 5
FITS, FAILS_IN_FEW = 0.5, 0.3
"""Agreement from which on cameras fit the depth. Fewer than `FEWEST_TO_BE_SURE` frames may overlap
too little to reach it, and are accused below the second alone."""
FITS_WELL = 0.65
"""Right readings reach 0.55 to 0.95 on 24 sequences, in 21 of them at least this. Intrinsics by 1.5
or 3 once got the wrong one of fewer readings at 0.51 to 0.55."""
NUM_UNITS = 41
"""Looked at around one that fits, 2 % apart."""
LEAST_STEP, LARGEST_STEP = 0.003, 10.0
"""Metres between neighbouring frames in a recording."""
MARGIN = 0.08
"""Of agreement, by which one reading must beat another to be believed."""
MEETS_NEARLY_ALL, SMALL_MARGIN = 0.8, 0.02
"""Agreement from which on the given reading is believed by this smaller margin: hardly a surface is
left that could decide against another."""
LEAST_SHIFT = 1.0
"""Pixels, of `SIZE`, by which a reading must move surfaces to be told apart from the given one."""


@dataclass(frozen=True)
class Match:
    """How well the surfaces meet under one reading."""

    agreement: float
    """Share of the compared pixels whose surfaces meet, 0..1."""
    shift: float
    """Pixels, of `SIZE`, that the surfaces lie from where the given cameras put them."""


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
        few = few if with_depth else "not asked, because there is none."
        return Verdict(None, few, {})
    view = cache(lambda index: _View.of(with_depth[index]))
    pairs = [
        (here, there)
        for here, there in _pairs(with_depth, depth_range)
        if view(here).depth.any() and view(there).depth.any()
    ]
    if not pairs:
        return Verdict(None, "the depth maps are empty where photos overlap.", {})
    is_few = len(with_depth) < FEWEST_TO_BE_SURE
    known = ALL_READINGS if is_few else (*ALL_READINGS, *IN_ANOTHER_UNIT.values())
    readings = [r for r in known if r is GIVEN or _is_plausible(with_depth, r)]
    views = [(view(here), view(there)) for here, there in pairs]
    matches = _with_finer_unit(views, _matches(views, readings))
    fits, sentence = _accusation(matches, FAILS_IN_FEW if is_few else FITS) or (True, "")
    if fits and is_unregistered(with_depth, pairs):
        fits, sentence = False, f"the cameras {UNREGISTERED} (the photos then match better)."
    elif fits:
        fits, sentence = _acquittal(matches, _typical_step(with_depth, GIVEN))
    return Verdict(fits, sentence, {remedy: match.agreement for remedy, match in matches.items()})


def _accusation(matches: dict[str, Match], fails: float) -> tuple[bool | None, str] | None:
    """(False or None, the sentence) where the given cameras do not fit the depth.

    `fails` is the agreement below which they do not where no others do.
    """
    given = matches[AS_GIVEN].agreement
    best = max(matches, key=lambda remedy: matches[remedy].agreement)
    reached = matches[best].agreement
    if given < fails and reached < FITS:
        sentence = f"no convention fits: at best {reached:.0%} of the surfaces meet."
        return False, f"{sentence} Are the poses those of these photos?"
    if reached >= FITS and reached - given > MARGIN:
        share = f"({reached:.0%} of the surfaces then meet, not {given:.0%})."
        if reached >= FITS_WELL:
            return False, f"the cameras {best} {share}"
        return False, f"no convention we know fits well; the closest: the cameras {best} {share}"
    if given < FITS:
        weak = (
            f"only {given:.0%} of the surfaces meet, and no other convention fits clearly better."
        )
        return None, f"the depth does not tell whether the cameras fit: {weak}"
    return None


def _acquittal(matches: dict[str, Match], step: float) -> tuple[bool | None, str]:
    """(True, the sentence) unless cameras meant otherwise would fit the depth as well: then None.

    `step` is metres between neighbouring frames.
    """
    given = matches[AS_GIVEN].agreement
    told_apart = {r: m.agreement for r, m in matches.items() if m.shift >= LEAST_SHIFT}
    if not any(reading.remedy in told_apart for reading in OTHER_POSES):
        still = f"the cameras hardly move, {1000 * step:.1f} mm from frame to frame"
        return None, f"{still}, so that conventions cannot be told apart by the depth."
    # Of unregistered depth the photos have been asked: here it must only not fit clearly better.
    above = {r: a - 1.5 * MARGIN if r == UNREGISTERED else a for r, a in told_apart.items()}
    rival = max(above, key=lambda remedy: above[remedy])
    if above[rival] > given - (SMALL_MARGIN if given >= MEETS_NEARLY_ALL else MARGIN):
        sentence = f"the depth does not tell whether the cameras fit: {given:.0%} of the surfaces"
        return None, f"{sentence} meet, and {told_apart[rival]:.0%} if the cameras {rival}."
    sentence = f"the cameras fit the depth: {given:.0%} of the surfaces meet"
    return True, f"{sentence} (at most {max(told_apart.values()):.0%} otherwise)."


def _is_plausible(frames: Sequence[Frame], reading: Reading) -> bool:
    """Whether cameras then step as hands and robots do.

    Without this, dividing translations by 1000 would often fit: it leaves the rotation alone.
    """
    return LEAST_STEP <= _typical_step(frames, reading) <= LARGEST_STEP


def _typical_step(frames: Sequence[Frame], reading: Reading) -> float:
    """Median distance of neighbours in the recording, metres."""
    poses = reading.poses(np.stack([frame.world_from_cam for frame in frames]))
    return float(np.median(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)))


def _pairs(frames: Sequence[Frame], depth_range: DepthRange) -> list[tuple[int, int]]:
    """Neighbours in the recording, and photos that overlap as the poses are given."""
    references = np.unique(np.linspace(0, len(frames) - 1, NUM_REFERENCES).round().astype(int))
    cameras = Cameras.of(frames)
    useful = frustum_overlap(cameras, depth_range) * angle_preference(cameras, depth_range)
    pairs = {(int(r), int(useful[r].argmax())) for r in references if useful[r].any()}
    for step in (1, 4):
        pairs |= {(int(r), int(r) + step) for r in references if r + step < len(frames)}
    return sorted(pairs)


@dataclass(frozen=True)
class _View:
    """A frame at `SIZE`."""

    depth: Float[np.ndarray, "height width"]
    intrinsics: Float[np.ndarray, "3 3"]
    world_from_cam: Float[np.ndarray, "4 4"]

    @staticmethod
    def of(frame: Frame) -> "_View":
        depth = frame.depth
        assert depth is not None
        return _View(
            resize_nearest(depth, SIZE).astype(np.float64),
            resize_intrinsics(frame.intrinsics, frame.size, SIZE),
            frame.world_from_cam,
        )


def _matches(views: Sequence[tuple[_View, _View]], readings: Sequence[Reading]) -> dict[str, Match]:
    """For each reading, by its remedy."""
    given = [_carried(here, there, GIVEN)[0] for here, there in views]
    return {reading.remedy: _match(views, given, reading) for reading in readings}


def _with_finer_unit(
    views: Sequence[tuple[_View, _View]], matches: dict[str, Match]
) -> dict[str, Match]:
    """The same, with the unit measured where another one fits best: a tenth off is all of depth.

    It is the middle of those under which about as many surfaces meet.
    """
    best = max(matches, key=lambda remedy: matches[remedy].agreement)
    coarse = [unit for unit, reading in IN_ANOTHER_UNIT.items() if reading.remedy == best]
    if not coarse:
        return matches
    units = coarse[0] * np.geomspace(1 / UNIT_REACH, UNIT_REACH, NUM_UNITS)
    found = [_matches(views, [in_unit(unit)]) for unit in units]
    agreements = np.array([match.agreement for each in found for match in each.values()])
    fitting = np.nonzero(agreements >= agreements.max() - SMALL_MARGIN)[0]
    kept = {remedy: match for remedy, match in matches.items() if remedy != best}
    return kept | found[round(float(fitting.mean()))]


def _match(
    views: Sequence[tuple[_View, _View]],
    given: Sequence[Float[np.ndarray, "point 2"]],
    reading: Reading,
) -> Match:
    """Agreement is a mean over the better half of the pairs: others may show different things."""
    agreements, shifts = [], []
    for (here, there), pixels_as_given in zip(views, given, strict=True):
        pixels, z = _carried(here, there, reading)
        agreements.append(_share_that_meets(there, pixels, z))
        is_seen = _is_inside(pixels_as_given)
        apart = np.linalg.norm(pixels[is_seen] - pixels_as_given[is_seen], axis=1)
        shifts.append(np.median(apart) if is_seen.any() else 0.0)
    better_half = sorted(agreements, reverse=True)[: (len(agreements) + 1) // 2]
    return Match(float(np.mean(better_half)), float(np.median(shifts)))


def _carried(
    here: _View, there: _View, reading: Reading
) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, " point"]]:
    """(pixels, depths) of `here`'s surfaces in `there`; infinite pixels behind the camera."""
    rows, columns = np.nonzero(here.depth > 0)
    rays = viewing_rays(columns, rows, _intrinsics(here, reading))
    poses = reading.poses(np.stack([here.world_from_cam, there.world_from_cam]))
    there_from_here = np.linalg.inv(poses[1]) @ poses[0]
    points = moved(rays * here.depth[rows, columns, None], there_from_here)
    return to_pixels(points, _intrinsics(there, reading))


def _intrinsics(view: _View, reading: Reading) -> Float[np.ndarray, "3 3"]:
    size, focal = reading.size_factor, reading.focal_factor
    return view.intrinsics * [[size * focal, 1, size], [1, size * focal, size], [1, 1, 1]]


def _is_inside(pixels: Float[np.ndarray, "point 2"]) -> np.ndarray:
    column, row = pixels.T
    return (column >= 0) & (column < SIZE[0]) & (row >= 0) & (row < SIZE[1])


def _share_that_meets(
    there: _View, pixels: Float[np.ndarray, "point 2"], z: Float[np.ndarray, " point"]
) -> float:
    """Share of surfaces carried into `there` that meet the surface measured there.

    Where less than a fifth of them comes into view, a fifth is what they are a share of.
    """
    is_inside = _is_inside(pixels)
    column, row = pixels[is_inside].astype(int).T
    measured = there.depth[row, column]
    known = measured > 0
    met = np.abs(z[is_inside][known] - measured[known]) < TOLERANCE * measured[known]
    return float(met.sum() / max(known.sum(), 0.2 * len(z), 1))
