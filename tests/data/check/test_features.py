"""Features tell cameras that are a little off from those that fit."""

import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from mvsam import weights
from mvsam.cli import main
from mvsam.data.check.features import camera_hint, features_of
from mvsam.data.convert import write_posed_folder
from mvsam.data.formats import open_scene
from mvsam.data.streaming.augment import with_pose_noise
from mvsam.data.wrapped import WrappedScene
from mvsam.errors import InputError
from mvsam.geometry.pose import pose_from_rotation_vector
from mvsam.types import Frame, Scene

pytest.importorskip("pycolmap")

RANGE = (0.1, 5.0)


class Displaced(WrappedScene):
    """Every camera is off by about so much."""

    def __init__(self, metres: float, degrees: float):
        super().__init__(open_scene(weights.ASSETS / "sample"))
        self.by = metres, degrees

    def frame(self, index: int) -> Frame:
        dice = np.random.default_rng((5, index))
        return with_pose_noise(super().frame(index), *self.by, dice)


class Plain(Displaced):
    """Photos without anything to see."""

    def frame(self, index: int) -> Frame:
        frame = super().frame(index)
        width, height = frame.size
        return replace(frame, load_image=lambda: np.full((height, width, 3), 128, np.uint8))


def test_exact_cameras_are_not_off():
    features = features_of(Displaced(0.0, 0.0), RANGE)
    assert len(features.distances) == 5 and max(features.distances.values()) < 0.5
    assert not features.are_off and not features.mistaken


def test_displaced_cameras_are_off():
    features = features_of(Displaced(0.01, 0.3), RANGE)
    assert features.are_off and "--poses refined" in features.sentence


def test_mistaken_cameras_are_not_imprecise():
    features = features_of(Displaced(0.02, 8.0), RANGE)
    assert features.disagree and features.are_wrong and not features.are_off
    assert not features.mistaken and "cannot be told" in features.sentence


class OneMistaken(Displaced):
    """As it is, but for one camera that is turned by ten degrees."""

    def frame(self, index: int) -> Frame:
        frame = super().frame(index)
        turn = pose_from_rotation_vector(np.array([0.0, 0.17, 0.0]), np.zeros(3))
        return replace(frame, world_from_cam=frame.world_from_cam @ turn) if index == 2 else frame


def test_one_mistaken_camera_is_named_and_spoils_no_other():
    scene = OneMistaken(0.0, 0.0)
    features = features_of(scene, RANGE)
    name = scene.frame(2).name
    assert features.mistaken == (name,) and not features.are_off
    assert all(pixels < 0.7 for photo, pixels in features.distances.items() if photo != name)


def test_of_two_photos_neither_is_accused():
    class Two(OneMistaken):
        def __len__(self) -> int:
            return 2

        def frame(self, index: int) -> Frame:
            return super().frame((0, 2)[index])

        def views(self):
            return None

    features = features_of(Two(0.0, 0.0), RANGE)
    assert features.disagree and not features.mistaken


def test_a_mistaken_camera_makes_the_scene_suspicious(tmp_path, capsys):
    list(write_posed_folder(OneMistaken(0.0, 0.0), tmp_path / "room"))
    assert main(["data", "check", str(tmp_path / "room"), "--strict", "--json"]) == 1
    (report,) = json.loads(capsys.readouterr().out)
    assert report["verdict"] == "wrong" and report["is_suspicious"]


def test_plain_photos_cannot_tell():
    features = features_of(Plain(0.01, 0.3), RANGE)
    assert not features.distances and "cannot tell" in features.sentence


def test_without_colmap_they_are_not_asked(monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    features = features_of(Displaced(0.01, 0.3), RANGE)
    assert not features.distances and "the extra colmap" in features.sentence


TUPLES = [(0, 1, 2), (1, 0, 2), (2, 1, 3)]


def test_the_hint_speaks_of_cameras_that_do_not_fit_and_of_no_others():
    assert camera_hint(Displaced(0.0, 0.0), TUPLES) is None
    assert camera_hint(Plain(0.01, 0.3), TUPLES) is None
    displaced = camera_hint(Displaced(0.01, 0.3), TUPLES)
    assert displaced is not None and "--poses refined" in displaced.sentence
    mistaken = camera_hint(OneMistaken(0.0, 0.0), [(0, 1, 2), (3, 1, 2)])
    assert mistaken is not None and mistaken.are_wrong


def test_cameras_without_a_unit_get_no_hint():
    scene = Displaced(0.01, 0.3)
    scene.has_unit = False
    assert camera_hint(scene, TUPLES) is None


def predict_first(scene: Scene, folder: Path) -> int:
    """Exit code of `mvsam predict` for one photo of the scene."""
    if not (folder / "room").exists():
        list(write_posed_folder(scene, folder / "room"))
    arguments = [str(folder / "room"), "--out", str(folder / "out"), "--references", "0000"]
    return main(["predict", *arguments])


def test_predict_gives_the_hint_once_it_has_written(tmp_path, capsys):
    scene = Displaced(0.01, 0.3)
    assert predict_first(scene, tmp_path) == 0
    assert "--poses refined lets the photos correct" in capsys.readouterr().err
    assert predict_first(scene, tmp_path) == 0
    assert "--poses refined" not in capsys.readouterr().err


@pytest.mark.parametrize("failure", [InputError("0003 cannot be read"), OSError("no space left")])
def test_a_hint_that_fails_spoils_no_prediction(tmp_path, capsys, monkeypatch, failure: Exception):
    def fail(name: str, frames: Sequence[Frame]) -> NoReturn:
        raise failure

    monkeypatch.setattr("mvsam.data.check.features._features_of", fail)
    assert predict_first(Displaced(0.01, 0.3), tmp_path) == 0
    captured = capsys.readouterr()
    assert "1 photo predicted" in captured.out and str(failure) in captured.err


def test_the_verdict_says_what_to_add(tmp_path, capsys):
    list(write_posed_folder(Displaced(0.01, 0.3), tmp_path / "room"))
    assert main(["data", "check", str(tmp_path / "room"), "--strict"]) == 0
    assert "imprecise; add --poses refined" in capsys.readouterr().out


def test_large_photos_are_reduced_and_their_cameras_say_the_same():
    class Large(Displaced):
        """Photos of 8 times the size, with nothing new in them."""

        def frame(self, index: int) -> Frame:
            frame = super().frame(index)
            size = (8 * frame.size[0], 8 * frame.size[1])

            def load() -> np.ndarray:
                return frame.image.repeat(8, axis=0).repeat(8, axis=1)

            scale = np.diag([8.0, 8.0, 1.0])
            return replace(frame, size=size, intrinsics=scale @ frame.intrinsics, load_image=load)

    features = features_of(Large(0.0, 0.0), RANGE)
    assert features.distances and not features.are_wrong
    # A pixel is one of 640, and these show blocks of four of them.
    assert max(features.distances.values()) < 2
