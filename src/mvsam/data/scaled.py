"""A scene whose poses come in another unit than metres."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mvsam.data.labels import SCANNET20
from mvsam.errors import InputError
from mvsam.types import Frame, Scene


class ScaledScene:
    """The same scene with poses in metres; `scale` is how many metres their unit has.

    Depth stays as it is: every format states its unit. Raises `InputError` for a scale that is not
    positive.
    """

    def __init__(self, scene: Scene, scale: float):
        if not (np.isfinite(scale) and scale > 0):
            raise InputError(f"a scale of {scale:g} metres a unit is not possible; give > 0.")
        self._scene, self._scale = scene, scale
        self.classes = getattr(scene, "classes", SCANNET20)
        points = getattr(scene, "points", None)
        self.points = None if points is None else points * scale

    @property
    def name(self) -> str:
        return self._scene.name

    def __len__(self) -> int:
        return len(self._scene)

    def frame(self, index: int) -> Frame:
        frame = self._scene.frame(index)
        pose = frame.world_from_cam.copy()
        pose[:3, 3] *= self._scale
        return replace(frame, world_from_cam=pose)

    def views(self) -> Sequence[tuple[int, ...]] | None:
        return self._scene.views()
