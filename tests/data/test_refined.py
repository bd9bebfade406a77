"""Cameras that are a little off are corrected by their photos; the sentences where none can be."""

import json
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from mvsam import weights
from mvsam.cli import main
from mvsam.data.catalog import open_data
from mvsam.data.convert import write_posed_folder
from mvsam.data.formats import open_scene
from mvsam.data.refined import RefinedScene, refined_poses, without_mistaken
from mvsam.data.streaming.augment import with_pose_noise
from mvsam.data.wrapped import WrappedScene
from mvsam.errors import InputError, MissingExtraError
from mvsam.geometry.epipolar import Matches
from mvsam.geometry.points import moved, to_pixels, viewing_rays
from mvsam.geometry.pose import pose_from_rotation_vector
from mvsam.inference.photos import refine_poses
from mvsam.types import Frame

pytest.importorskip("pycolmap")

SAMPLE = weights.ASSETS / "sample"


class Displaced(WrappedScene):
    """Every camera is off by about half a degree and two centimetres."""

    def frame(self, index: int) -> Frame:
        dice = np.random.default_rng((5, index))
        return with_pose_noise(super().frame(index), 0.01, 0.3, dice)


class Plain(WrappedScene):
    """Photos without anything to see."""

    def frame(self, index: int) -> Frame:
        frame = super().frame(index)
        width, height = frame.size
        return replace(frame, load_image=lambda: np.full((height, width, 3), 128, np.uint8))


def misses(scene, truth) -> float:
    """Pixels, median over true surfaces of photo 0, between where each is seen in another and where
    the scene's cameras would have it."""
    first = truth.frame(0)
    rows, columns = (2 + 4 * n for n in np.indices((60, 75)).reshape(2, -1))
    points = viewing_rays(columns, rows, first.intrinsics) * first.depth[rows, columns, None]
    found = []
    for index in range(1, 5):
        pixels = [
            to_pixels(
                moved(
                    points, np.linalg.inv(s.frame(index).world_from_cam) @ s.frame(0).world_from_cam
                ),
                first.intrinsics,
            )[0]
            for s in (scene, truth)
        ]
        found.append(np.median(np.linalg.norm(pixels[0] - pixels[1], axis=1)))
    return float(np.mean(found))


def test_photos_correct_displaced_cameras(caplog):
    truth = open_scene(SAMPLE)
    displaced = Displaced(truth)
    refined = RefinedScene(displaced)
    assert misses(refined, truth) < 0.75 * misses(displaced, truth)
    assert "turned the cameras by" in caplog.text and "before" in caplog.text
    assert refined.views() == truth.views() and refined.name == truth.name


def test_cameras_that_fit_stay(caplog):
    truth = open_scene(SAMPLE)
    refined = RefinedScene(truth)
    assert np.array_equal(refined.frame(3).world_from_cam, truth.frame(3).world_from_cam)
    assert "its cameras fit its photos" in caplog.text


def test_a_mistaken_camera_stays_and_is_named_and_moves_no_other(caplog):
    truth = open_scene(SAMPLE)
    frames = [Displaced(truth).frame(index) for index in range(5)]
    turn = pose_from_rotation_vector(np.array([0.0, 0.3, 0.0]), np.array([0.2, 0.0, 0.0]))
    frames[3] = replace(frames[3], world_from_cam=frames[3].world_from_cam @ turn)
    found = refined_poses("room", frames)
    np.testing.assert_allclose(found[3], frames[3].world_from_cam, atol=1e-9)
    assert f"the camera of {frames[3].name} is mistaken" in caplog.text
    alone = refined_poses("room", [*frames[:3], frames[4]])
    for pose, expected in zip([*found[:3], found[4]], alone, strict=True):
        np.testing.assert_allclose(pose, expected, atol=1e-6)


def test_cameras_that_fit_stay_beside_a_mistaken_one(caplog):
    truth = open_scene(SAMPLE)
    frames = [truth.frame(index) for index in range(5)]
    turn = pose_from_rotation_vector(np.array([0.0, 0.3, 0.0]), np.array([0.2, 0.0, 0.0]))
    frames[3] = replace(frames[3], world_from_cam=frames[3].world_from_cam @ turn)
    found = refined_poses("room", frames)
    assert all(np.array_equal(p, f.world_from_cam) for p, f in zip(found, frames, strict=True))
    assert f"the camera of {frames[3].name} is mistaken" in caplog.text
    assert "its other cameras fit its photos" in caplog.text


def test_who_matches_none_but_a_mistaken_camera_is_not_accused():
    """Cameras 0 to 3 match each other, 4 matches 3 alone, and 3 is wrong."""
    dice = np.random.default_rng(0)
    world = torch.from_numpy(dice.uniform((-1, -1, 2), (1, 1, 4), (60, 3)))
    poses = torch.eye(4, dtype=torch.float64).repeat(5, 1, 1)
    poses[:, 0, 3] = 0.1 * torch.arange(5)

    def rays(camera: int) -> torch.Tensor:
        points = world - poses[camera, :3, 3]
        return points / points[:, 2:]

    known = [(i, j) for i in range(4) for j in range(i)] + [(4, 3)]
    pairs = [Matches(i, j, rays(i), rays(j)) for i, j in known]
    wrong = poses.clone()
    wrong[3, 1, 3] += 0.3
    kept, mistaken = without_mistaken(wrong, pairs, most=0.01)
    assert mistaken == [3]
    assert {(pair.first, pair.second) for pair in kept} == {(1, 0), (2, 0), (2, 1)}


def test_two_runs_agree():
    """`predict` goes on only where the cameras are the same to the last bit."""
    first, second = (RefinedScene(Displaced(open_scene(SAMPLE))) for _ in range(2))
    for index in range(5):
        assert np.array_equal(first.frame(index).world_from_cam, second.frame(index).world_from_cam)


def test_photos_in_memory():
    displaced = Displaced(open_scene(SAMPLE))
    frames = [displaced.frame(index) for index in range(5)]
    to_opencv = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    found = refine_poses(
        [frame.image for frame in frames],
        [frame.intrinsics - to_opencv for frame in frames],
        [frame.world_from_cam for frame in frames],
    )
    refined = RefinedScene(displaced)
    for index, pose in enumerate(found):
        np.testing.assert_allclose(pose, refined.frame(index).world_from_cam, atol=1e-6)
    with pytest.raises(InputError, match="one of each"):
        refine_poses([frames[0].image], [], [])
    with pytest.raises(InputError, match="give 2 or more"):
        refine_poses([frames[0].image], [frames[0].intrinsics], [frames[0].world_from_cam])


def test_it_is_a_way_to_open_scenes(tmp_path, caplog):
    for name in ("a", "b"):
        list(write_posed_folder(Displaced(open_scene(SAMPLE)), tmp_path / name))
    for path in (tmp_path, tmp_path / "a"):
        caplog.clear()
        scenes = open_data(str(path), poses="refined")
        assert misses(scenes[0], open_scene(SAMPLE)) < misses(
            open_scene(tmp_path / "a"), open_scene(SAMPLE)
        )
        assert "a: its photos turned" in caplog.text


class SomeDisplaced(Displaced):
    """Of photos 3 and 4 alone, as after a tracker's jump."""

    def frame(self, index: int) -> Frame:
        return super().frame(index) if index >= 3 else self._scene.frame(index)


def test_a_few_wrong_cameras_show(caplog):
    truth = open_scene(SAMPLE)
    some = SomeDisplaced(truth)
    assert misses(RefinedScene(some), truth) < misses(some, truth)
    assert "turned the cameras" in caplog.text


class Mistaken(WrappedScene):
    """World-to-camera poses."""

    def frame(self, index: int) -> Frame:
        frame = super().frame(index)
        return replace(frame, world_from_cam=np.linalg.inv(frame.world_from_cam))


class Tripod(WrappedScene):
    """All cameras at one place."""

    def frame(self, index: int) -> Frame:
        frame = super().frame(index)
        pose = frame.world_from_cam.copy()
        pose[:3, 3] = 0
        return replace(frame, world_from_cam=pose)


@pytest.mark.parametrize(
    ("kind", "sentence"),
    (
        (Mistaken, "disagree with its cameras"),
        (Tripod, "less than 1 cm apart"),
    ),
)
def test_cameras_that_photos_cannot_correct_stay(kind, sentence, caplog):
    scene = kind(open_scene(SAMPLE))
    refined = RefinedScene(scene)
    for index in range(5):
        pose = scene.frame(index).world_from_cam
        assert np.array_equal(refined.frame(index).world_from_cam, pose)
    assert sentence in caplog.text


class Tuple(WrappedScene):
    def views(self):
        return [(0, 1, 2)]


def test_only_photos_of_prescribed_tuples_are_matched(caplog):
    displaced = Tuple(Displaced(open_scene(SAMPLE)))
    refined = RefinedScene(displaced)
    moved = [
        not np.array_equal(refined.frame(i).world_from_cam, displaced.frame(i).world_from_cam)
        for i in range(5)
    ]
    assert moved == [True, True, True, False, False]
    assert "features of 3 photos" in caplog.text


def test_prediction_goes_on_with_the_same_cameras(tmp_path):
    list(write_posed_folder(Displaced(open_scene(SAMPLE)), tmp_path / "room"))
    arguments = ["predict", str(tmp_path / "room"), "--poses", "refined", "--views", "2"]
    arguments += ["--out", str(tmp_path / "out"), "--references"]
    first = next((tmp_path / "room" / "color").iterdir()).stem
    assert main([*arguments, first]) == 0
    assert main([*arguments, first]) == 0, "the cameras are the same to the last bit"
    assert main([*arguments, first, "--poses", "given"]) == 2


@pytest.mark.parametrize("num_matched", [5, 3])
def test_depth_is_scored_with_corrected_cameras(num_matched: int, tmp_path, capsys, caplog):
    """Of prescribed tuples the photos alone are matched."""
    list(write_posed_folder(Displaced(open_scene(SAMPLE)), tmp_path / "room"))
    arguments = ["eval", "tiny", "--data", str(tmp_path / "room"), "--limit", "1", "--json"]
    if num_matched == 3:
        names = [path.stem for path in sorted((tmp_path / "room" / "color").iterdir())]
        (tmp_path / "tuples.txt").write_text(" ".join(["room", *names[:3]]) + "\n")
        arguments += ["--tuples", str(tmp_path / "tuples.txt")]
    rel = {}
    for poses in ("given", "refined"):
        capsys.readouterr()
        assert main([*arguments, "--poses", poses]) == 0
        rel[poses] = json.loads(capsys.readouterr().out)["rel"]
    assert f"matches the features of {num_matched} photos" in caplog.text
    assert rel["refined"] != rel["given"]


def test_photos_that_match_nowhere_leave_the_cameras(caplog):
    plain = Plain(open_scene(SAMPLE))
    refined = RefinedScene(plain)
    for index in range(5):
        pose = plain.frame(index).world_from_cam
        assert np.array_equal(refined.frame(index).world_from_cam, pose)
    assert "no two have 15 features in common" in caplog.text


def test_a_missing_pycolmap_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(MissingExtraError, match=r"corrected poses .*pip install 'mvsam\[colmap\]'"):
        open_scene(SAMPLE, poses="refined")


def test_too_many_photos_are_refused():
    with pytest.raises(InputError, match="has 200 photos"):
        refined_poses("log", [open_scene(SAMPLE).frame(0)] * 200)


def test_data_without_wrong_cameras_say_so(tmp_path):
    with pytest.raises(InputError, match="exact poses; leave --poses out"):
        open_data("rooms:val:0-1", poses="refined")
    for kind in ("color", "labels"):
        shutil.copytree(SAMPLE / kind, tmp_path / kind)
    shutil.copy(SAMPLE / "intrinsics.txt", tmp_path)
    with pytest.raises(InputError, match="leave --poses refined out"):
        open_data(str(tmp_path), poses="refined")
