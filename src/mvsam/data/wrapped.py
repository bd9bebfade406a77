"""A scene seen through another: what scaling, prescribed tuples and shards have in common."""

from collections.abc import Sequence

import numpy as np

from mvsam.data.labels import SCANNET20, ClassTable
from mvsam.types import Frame, Scene


class WrappedScene:
    """The same scene; subclasses change one thing.

    points: sparse points of its surfaces in world axes, point x 3, where its format has some.
    num_lost: pictures of it that have no pose.
    """

    def __init__(self, scene: Scene):
        self._scene = scene
        self.classes: ClassTable = getattr(scene, "classes", SCANNET20)
        self.points: np.ndarray | None = getattr(scene, "points", None)
        self.num_lost: int = getattr(scene, "num_lost", 0)

    @property
    def name(self) -> str:
        return self._scene.name

    def __len__(self) -> int:
        return len(self._scene)

    def frame(self, index: int) -> Frame:
        return self._scene.frame(index)

    def views(self) -> Sequence[tuple[int, ...]] | None:
        return self._scene.views()
