"""Whether features that photos share lie where the cameras would have them, or a little off."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from mvsam.data.about import About
from mvsam.data.depth_range import DepthRange
from mvsam.data.matches import match_photos, pixel_size
from mvsam.data.readers.colmap import import_pycolmap
from mvsam.data.refined import GOOD_ENOUGH, MOST_OFF, apart, camera_distances, without_mistaken
from mvsam.data.sampling import ViewTuple, evenly_spaced, view_tuples
from mvsam.errors import InputError, MissingExtraError
from mvsam.geometry.epipolar import epipolar_distances
from mvsam.types import Scene

NUM_TUPLES, NUM_VIEWS = 4, 3
"""Tuples, evenly spaced, whose photos are matched, and the photos of each."""
NUM_TUPLES_IN_PASSING = 2
"""Where the precision of the cameras is a remark, not the question."""


@dataclass(frozen=True)
class Features:
    """What matched features say about how precise the cameras are."""

    sentence: str
    distances: dict[str, float] = field(default_factory=dict)
    """Photo -> pixels (of 640, in wider photos) that its features are from their epipolar lines,
    the median. Empty: they cannot tell."""
    mistaken: tuple[str, ...] = ()
    """Photos whose cameras are not imprecise but wrong, worst first."""
    disagree: bool = False
    """Whether so many cameras are off that the mistaken ones cannot be told from the others."""

    @property
    def are_wrong(self) -> bool:
        return self.disagree or bool(self.mistaken)

    @property
    def are_off(self) -> bool:
        """Whether `--poses refined` may correct the cameras."""
        others = (pixels for name, pixels in self.distances.items() if name not in self.mistaken)
        return not self.disagree and any(pixels > GOOD_ENOUGH for pixels in others)


def camera_hint(scene: Scene, tuples: Sequence[ViewTuple]) -> Features | None:
    """What features say against the cameras of two of the tuples; None: nothing to speak of.

    Seconds for half a dozen photos; without the extra `colmap` nothing is asked. InputError for a
    damaged photo.
    """
    if not About.of(scene).has_unit:  # COLMAP's cameras fit, and are refined in metres alone
        return None
    inner = evenly_spaced(tuples, NUM_TUPLES_IN_PASSING + 2)[1:-1] or tuples
    features = _features_of(scene, [views[:NUM_VIEWS] for views in inner])
    return features if features.are_off or features.are_wrong else None


def features_of(scene: Scene, depth_range: DepthRange) -> Features:
    """Of a dozen photos that are seen together; takes seconds. InputError for a damaged photo."""
    try:
        tuples, _ = view_tuples(scene, NUM_VIEWS, depth_range)
    except InputError:  # no photos overlap: other lines of the report say why
        return _CANNOT_TELL
    return _features_of(scene, evenly_spaced(tuples, NUM_TUPLES))


def _features_of(scene: Scene, tuples: Sequence[ViewTuple]) -> Features:
    try:
        import_pycolmap("matched features")
    except MissingExtraError:
        return Features("not asked, which takes the extra colmap.")
    frames = [scene.frame(index) for index in sorted({i for views in tuples for i in views})]
    for frame in frames:
        _ = frame.image
    try:
        matches = match_photos(scene.name, frames)
    except InputError as error:
        return Features(f"not asked: {error}")
    poses = torch.from_numpy(np.stack([frame.world_from_cam for frame in frames]))
    pairs = apart(matches, poses)
    if not pairs:
        return _CANNOT_TELL
    pixel = pixel_size(frames)
    off = camera_distances(epipolar_distances(poses, pairs), pairs)
    kept, wrong = without_mistaken(poses, pairs, MOST_OFF * pixel)
    if kept:  # a mistaken camera spoils those of the photos it matches
        agreeing = camera_distances(epipolar_distances(poses, kept), kept)
        off = {index: off[index] for index in wrong} | agreeing
    distances = {frames[index].name: metres / pixel for index, metres in sorted(off.items())}
    mistaken = tuple(frames[index].name for index in wrong)
    return Features(_sentence(distances, mistaken, not kept), distances, mistaken, not kept)


_CANNOT_TELL = Features("they cannot tell: too few are shared by photos taken apart.")


def _sentence(distances: dict[str, float], mistaken: tuple[str, ...], disagree: bool) -> str:
    worst = max(distances, key=lambda name: distances[name])
    where = f"{distances[worst]:.1f} pixels from their epipolar lines at the worst camera ({worst})"
    if disagree:
        return f"{where}; so many are off that the mistaken ones cannot be told from the others."
    if mistaken:
        return f"{where}; {', '.join(mistaken)}: mistaken, not imprecise."
    if distances[worst] <= GOOD_ENOUGH:
        return f"{where}: as near as features are found."
    return f"{where}; --poses refined lets the photos correct the cameras."
