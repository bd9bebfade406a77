"""A scene seen through another: what scaling, prescribed tuples and shards have in common."""

import logging
from collections.abc import Sequence
from dataclasses import replace

from mvsam.data.about import About
from mvsam.data.labels import ClassTable
from mvsam.types import Frame, Scene

log = logging.getLogger("mvsam")


class WrappedScene:
    """The same scene, with what its format says of it (`About`); subclasses change one thing."""

    def __init__(self, scene: Scene):
        self._scene = scene
        about = About.of(scene)
        self.classes, self.points, self.num_lost = about.classes, about.points, about.num_lost
        self.has_unit, self.has_poses = about.has_unit, about.has_poses

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
