"""A scene seen through another: what scaling, prescribed tuples and shards have in common."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mvsam.data.labels import SCANNET20, ClassTable
from mvsam.types import Frame, Scene

log = logging.getLogger("mvsam")


class WrappedScene:
    """The same scene; subclasses change one thing.

    points: sparse points of its surfaces in world axes, point x 3, where its format has some.
    num_lost: pictures of it that have no pose. has_unit: whether its poses are in metres.
    """

    def __init__(self, scene: Scene):
        self._scene = scene
        self.classes: ClassTable = getattr(scene, "classes", SCANNET20)
        self.points: np.ndarray | None = getattr(scene, "points", None)
        self.num_lost: int = getattr(scene, "num_lost", 0)
        self.has_unit: bool = getattr(scene, "has_unit", True)

    @property
    def name(self) -> str:
        return self._scene.name

    def __len__(self) -> int:
        return len(self._scene)

    def frame(self, index: int) -> Frame:
        return self._scene.frame(index)

    def views(self) -> Sequence[tuple[int, ...]] | None:
        return self._scene.views()


class LabelsOf(WrappedScene):
    """The same scene, without labels where they are of other classes than `classes`; it says so."""

    def __init__(self, scene: Scene, classes: ClassTable):
        super().__init__(scene)
        self._fits = self.classes.names == classes.names
        if not self._fits:
            log.warning(
                "%s: its %d classes are not the model's %d; its labels do not count.",
                *(scene.name, len(self.classes), len(classes)),
            )

    def frame(self, index: int) -> Frame:
        frame = super().frame(index)
        return frame if self._fits else replace(frame, load_labels=None)
