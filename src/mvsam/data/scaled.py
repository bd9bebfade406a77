"""Scenes whose poses come in another unit than metres, and what `--scale` says of that unit."""

import logging
import re
from dataclasses import dataclass, replace
from difflib import get_close_matches

import numpy as np

from mvsam.data.wrapped import WrappedScene
from mvsam.errors import InputError
from mvsam.types import Frame, Scene

_SMALLEST_DISTANCE = 1e-6
"""Of two cameras, as a part of the way to the farthest one: below it, rounding alone is left."""

log = logging.getLogger("mvsam")


@dataclass(frozen=True)
class Baseline:
    """A distance that was measured: between the camera centres of two photos of a scene."""

    first: str
    """A photo's name, with or without ending."""
    second: str
    metres: float

    def metres_a_unit(self, scene: Scene) -> float:
        """The scale of the scene's poses; InputError where they do not tell it."""
        frames = [scene.frame(index) for index in range(len(scene))]
        names = [frame.name for frame in frames]
        first, second = (_photo(name, names, scene.name) for name in (self.first, self.second))
        if first == second:
            raise InputError(f"--scale: {self.first} and {self.second} are one photo; name two.")
        centres = np.stack([frame.world_from_cam[:3, 3] for frame in frames])
        ways = np.linalg.norm(centres - centres[first], axis=1)
        if ways[second] <= _SMALLEST_DISTANCE * ways.max():
            raise InputError(
                f"{scene.name}: the cameras of {self.first} and {self.second} stand at one place, "
                "so their distance gives no scale; name two that are far apart."
            )
        return float(self.metres / ways[second])


def parse_scale(scale: float | str) -> float | Baseline:
    """What `--scale` says: metres a unit, or `A:B=METRES`, the distance of two photos' cameras."""
    try:
        return float(scale)
    except ValueError as error:
        match = re.fullmatch(r"(.+):(.+)=([^=]*)", str(scale))
        if match is None:
            raise InputError(
                f"--scale {scale}: give metres a unit, as 0.31, or two photos and the metres "
                "between their cameras, as 0001.jpg:0007.jpg=0.25."
            ) from error
    first, second, distance = match.groups()
    try:
        metres = float(distance)
    except ValueError:
        metres = np.nan
    if not (np.isfinite(metres) and metres > 0):
        raise InputError(f"--scale {scale}: '{distance}' is no distance in metres; give > 0.")
    return Baseline(first, second, metres)


def in_metres(scene: Scene, scale: float | Baseline) -> Scene:
    """The scene with poses in metres; a message says how long a unit is by a measured distance."""
    if isinstance(scale, Baseline):
        metres = scale.metres_a_unit(scene)
        log.info(
            "%s: one unit of the poses is %.4g m, because the cameras of %s and %s are %g m apart.",
            scene.name, metres, scale.first, scale.second, scale.metres,
        )  # fmt: skip
        return ScaledScene(scene, metres)
    return scene if scale == 1.0 else ScaledScene(scene, scale)


def _photo(name: str, names: list[str], scene: str) -> int:
    """The place among the frames' `names`; COLMAP's folders are part of theirs, as `left_0001`."""
    flat = name.replace("/", "_")
    for spelling in (flat, flat.rpartition(".")[0]):
        if spelling in names:
            return names.index(spelling)
    close = get_close_matches(flat, names) or [names[0], "...", names[-1]]
    raise InputError(f"{scene} has no photo named {name}; it has {', '.join(close)}.")


class ScaledScene(WrappedScene):
    """The same scene with poses in metres; `scale` is how many metres their unit has.

    Depth stays as it is: every format states its unit. Raises `InputError` for a scale that is not
    positive.
    """

    def __init__(self, scene: Scene, scale: float):
        if not (np.isfinite(scale) and scale > 0):
            raise InputError(f"a scale of {scale:g} metres a unit is not possible; give > 0.")
        super().__init__(scene)
        self._scale = scale
        self.has_unit = True
        self.points = None if self.points is None else self.points * scale

    def frame(self, index: int) -> Frame:
        frame = self._scene.frame(index)
        pose = frame.world_from_cam.copy()
        pose[:3, 3] *= self._scale
        return replace(frame, world_from_cam=pose)
