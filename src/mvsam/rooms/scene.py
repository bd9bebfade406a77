"""Scenes of procedural rooms: scene n of a split is the same everywhere and always."""

from collections.abc import Callable
from functools import cached_property, partial

import numpy as np

from mvsam.errors import InputError
from mvsam.types import Frame

from .assets import open_assets
from .camera_path import AROUND, CASUAL, WIDE, camera_path
from .dice import Dice
from .layout import build_room
from .photo import Sensor
from .render import Camera, render
from .room import Room

SPLITS: dict[str, int | None] = {
    "train": None, "wide": None, "around": None, "val": 100, "test": 100,
}  # fmt: skip
"""Number of scenes; None is unlimited. `wide` and `around` are to train on too: the views of the
one share little, most of the other go around one thing in wide steps, half in a bare room."""
VERSION = 4
"""Grows whenever a change alters a pixel, so that no cache serves rooms of another version."""
_SPLIT_KEYS = {"train": 101, "val": 202, "test": 303, "wide": 404, "around": 505}
_STYLES = {"wide": WIDE, "around": AROUND}


class RoomScene:
    """One room seen by one short hand-held camera path; a `Scene`.

    assets: folder of an asset pack, whose things and surfaces are then among the room's own.
    Built when first asked for; rendered frames stay in memory as long as the scene does. Frame i is
    the same whichever frames were rendered before.
    """

    def __init__(
        self, split: str, index: int, num_frames: int = 5, width: int = 320, height: int = 256,
        assets: str | None = None,
    ):  # fmt: skip
        _check(split, index)
        self._assets = None if assets is None else open_assets(assets)
        self.split, self.index = split, index
        self._num_frames, self._width, self._height = num_frames, width, height
        self._rendered: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    @property
    def name(self) -> str:
        return f"rooms/{self.split}/{self.index:04d}"

    def __len__(self) -> int:
        return self._num_frames

    @cached_property
    def room(self) -> Room:
        is_bare = self.split == "around" and self.index % 2 == 0
        return build_room(self._dice(0), self._assets, "bare" if is_bare else None)

    @cached_property
    def cameras(self) -> list[Camera]:
        size, style = (self._width, self._height), _STYLES.get(self.split, CASUAL)
        return camera_path(self.room, self._dice(1), len(self), *size, style)

    def frame(self, index: int) -> Frame:
        if not 0 <= index < len(self):
            raise InputError(f"{self.name} has no frame {index}: it has 0 to {len(self) - 1}.")
        camera = self.cameras[index]
        return Frame(
            name=f"{index:04d}",
            size=(self._width, self._height),
            intrinsics=camera.intrinsics.copy(),
            world_from_cam=camera.world_from_cam.copy(),
            load_image=self._map(index, 0),
            load_depth=self._map(index, 1),
            load_labels=self._map(index, 2),
        )

    def views(self) -> list[tuple[int, ...]]:
        """Each frame as reference, the others best first: about 12 cm away, same direction."""
        return [(i, *self._ranked_sources(i)) for i in range(len(self))]

    def _ranked_sources(self, reference: int) -> list[int]:
        others = [i for i in range(len(self)) if i != reference]
        return sorted(others, key=partial(self._mismatch, reference))

    def _mismatch(self, reference: int, source: int) -> float:
        """0 for a fine baseline and the same direction; grows with the loss of overlap."""
        here, there = self.cameras[reference].world_from_cam, self.cameras[source].world_from_cam
        baseline = float(np.linalg.norm(here[:3, 3] - there[:3, 3]))
        turn = float(np.arccos(np.clip(here[:3, 2] @ there[:3, 2], -1, 1)))
        outside = max(0.05 - baseline, 0.0) * 10 + max(baseline - 0.2, 0.0) * 2
        return outside + 0.2 * abs(baseline - 0.12) + max(turn - 0.1, 0.0)

    def _map(self, index: int, which: int) -> Callable[[], np.ndarray]:
        return lambda: self._render(index)[which].copy()

    def _render(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Image, depth and labels."""
        if index not in self._rendered:
            rendering = render(self.room, self.cameras[index])
            dice = self._dice(2, index)
            image = self._sensor.develop(rendering.radiance, self._exposure, dice)
            self._rendered[index] = image, rendering.depth, rendering.labels
        return self._rendered[index]

    @cached_property
    def _sensor(self) -> Sensor:
        return Sensor.draw(self._dice(4))

    @cached_property
    def _exposure(self) -> float:
        """Brings a typical surface to mid-grey, as a camera's light meter does; one for a scene."""
        camera = self.cameras[len(self) // 2]
        small = np.diag([32 / camera.width, 24 / camera.height, 1.0]) @ camera.intrinsics
        radiance = render(self.room, Camera(small, camera.world_from_cam, 32, 24)).radiance
        typical = float(np.exp(np.log(radiance.mean(axis=2) + 1e-3).mean()))
        return self._dice(3).uniform(0.2, 0.5) / typical

    def _dice(self, *purpose: int) -> Dice:
        return Dice(_SPLIT_KEYS[self.split], self.index, *purpose)


def scene(
    split: str, index: int, num_frames: int = 5, width: int = 320, height: int = 256,
    assets: str | None = None,
) -> RoomScene:  # fmt: skip
    return RoomScene(split, index, num_frames, width, height, assets)


def _check(split: str, index: int) -> None:
    if split not in SPLITS:
        raise InputError(f"rooms have no split '{split}': choose one of {', '.join(SPLITS)}.")
    count = SPLITS[split]
    if index < 0 or (count is not None and index >= count):
        wanted = "0 or more" if count is None else f"0 to {count - 1}"
        raise InputError(f"rooms:{split} has no scene {index}: the index must be {wanted}.")
