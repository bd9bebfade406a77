"""Whether features that photos share lie where the cameras would have them, or a little off."""

from dataclasses import dataclass

import numpy as np
import torch

from mvsam.data.depth_range import DepthRange
from mvsam.data.matches import match_photos, pixel_size
from mvsam.data.refined import GOOD_ENOUGH, MOST_OFF, apart, worst_camera
from mvsam.data.sampling import evenly_spaced, view_tuples
from mvsam.errors import InputError, MissingExtraError
from mvsam.geometry.epipolar import epipolar_distances
from mvsam.types import Scene

NUM_TUPLES, NUM_VIEWS = 4, 3
"""Tuples, evenly spaced, whose photos are matched, and the photos of each."""


@dataclass(frozen=True)
class Features:
    """What matched features say about how precise the cameras are."""

    distance: float | None
    """Pixels (of 640, in wider photos) from their epipolar lines: the median over the matches of
    the camera that is worst off. None: they cannot tell."""
    sentence: str

    @property
    def are_off(self) -> bool:
        """Whether `--poses refined` may correct the cameras."""
        return self.distance is not None and GOOD_ENOUGH < self.distance <= MOST_OFF


def features_of(scene: Scene, depth_range: DepthRange) -> Features:
    """Of a dozen photos that are seen together; takes seconds."""
    try:
        tuples, _ = view_tuples(scene, NUM_VIEWS, depth_range)
        chosen = sorted({i for views in evenly_spaced(tuples, NUM_TUPLES) for i in views})
        frames = [scene.frame(index) for index in chosen]
        poses = torch.from_numpy(np.stack([frame.world_from_cam for frame in frames]))
        pairs = apart(match_photos(scene.name, frames), poses)
    except MissingExtraError:
        return Features(None, "not asked, which takes the extra colmap.")
    except InputError:  # no photos overlap, or COLMAP fails: other lines of the report say why
        pairs = []
    if not pairs:
        return Features(None, "they cannot tell: too few are shared by photos taken apart.")
    distance = worst_camera(epipolar_distances(poses, pairs), pairs) / pixel_size(frames)
    return Features(distance, _sentence(distance))


def _sentence(distance: float) -> str:
    where = f"{distance:.1f} pixels from their epipolar lines at the worst camera"
    if distance <= GOOD_ENOUGH:
        return f"{where}: as near as features are found."
    if distance <= MOST_OFF:
        return f"{where}; --poses refined lets the photos correct the cameras."
    return f"{where}: the cameras are mistaken, not imprecise."
