from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mvsam.data.check.poses import pose_convention_hint
from mvsam.data.readers.posed_folder import PosedFolder
from mvsam.data.sampling import view_tuples
from mvsam.errors import InputError
from mvsam.geometry.pose import OPENCV_FROM_OPENGL
from mvsam.types import Frame
from tests.synthetic import write_posed_folder


def frames_of(folder, rewrite: Callable[[np.ndarray], np.ndarray] = lambda pose: pose):
    """The folder's frames after writing every pose in another convention."""
    for file in (folder / "poses").iterdir():
        np.savetxt(file, rewrite(np.loadtxt(file)), fmt="%.8f")
    scene = PosedFolder(folder)
    return [scene.frame(index) for index in range(len(scene))]


def left_handed(pose: np.ndarray) -> np.ndarray:
    negate_y = np.diag([1.0, -1.0, 1.0, 1.0])
    return negate_y @ pose @ negate_y


def turned_back(pose: np.ndarray) -> np.ndarray:
    return np.block([[pose[:3, :3].T, pose[:3, 3:]], [pose[3:]]])


@pytest.fixture
def folder(tmp_path):
    write_posed_folder(tmp_path, num_frames=6, size=(160, 120), depth=False, labels=False)
    return tmp_path


def test_right_poses_raise_no_suspicion(folder):
    assert pose_convention_hint(frames_of(folder)) is None


@pytest.mark.parametrize(
    ("rewrite", "expected"),
    [
        (np.linalg.inv, "the poses look world-to-camera; invert them"),
        (
            lambda pose: pose @ OPENCV_FROM_OPENGL,
            "the poses look in OpenGL axes (y up, z backward)",
        ),
        (
            lambda pose: np.linalg.inv(pose @ OPENCV_FROM_OPENGL),
            "look world-to-camera in OpenGL axes",
        ),
        (turned_back, "look turned the wrong way (transposed rotations)"),
        (left_handed, "the poses look left-handed (y up, z forward, as Unity's)"),
    ],
)
def test_photos_reveal_another_convention_though_the_frusta_overlap(folder, rewrite, expected):
    hint = pose_convention_hint(frames_of(folder, rewrite))
    assert hint is not None
    assert expected in hint
    assert "photos then match" in hint


def test_cameras_that_do_not_move_are_told(folder):
    def stay(pose: np.ndarray) -> np.ndarray:
        return np.block([[pose[:3, :3], 1e-5 * pose[:3, 3:]], [pose[3:]]])

    hint = pose_convention_hint(frames_of(folder, stay))
    assert hint is not None and "the cameras do not move" in hint


def no_pixels():
    raise AssertionError("the frusta alone tell")


def looking_at_a_table(num_frames: int) -> list[Frame]:
    """Cameras on a circle of 2 m, far from the world's origin, that look at its middle."""
    intrinsics = np.array([[100.0, 0, 80], [0, 100.0, 60], [0, 0, 1]])
    frames = []
    for index in range(num_frames):
        angle = 2 * np.pi * index / num_frames
        outward = np.array([np.sin(angle), 0, -np.cos(angle)])
        pose = np.eye(4)
        pose[:3, 0] = np.cross([0, 1.0, 0], -outward)
        pose[:3, 1] = [0, 1, 0]
        pose[:3, 2] = -outward
        pose[:3, 3] = np.array([4.0, 1, 3]) + 2 * outward
        frames.append(Frame(str(index), (160, 120), intrinsics, pose, no_pixels))
    return frames


def test_frusta_reveal_world_to_camera_poses():
    inverted = [
        Frame(f.name, f.size, f.intrinsics, np.linalg.inv(f.world_from_cam), no_pixels)
        for f in looking_at_a_table(9)
    ]
    hint = pose_convention_hint(inverted)
    assert hint is not None
    assert "world-to-camera; invert them (views then overlap by" in hint


def test_frusta_reveal_opengl_axes():
    flipped = [
        Frame(f.name, f.size, f.intrinsics, f.world_from_cam @ OPENCV_FROM_OPENGL, no_pixels)
        for f in looking_at_a_table(5)
    ]
    hint = pose_convention_hint(flipped)
    assert hint is not None
    assert "OpenGL axes" in hint
    assert "views then overlap" in hint


def test_poses_in_millimetres_are_called_not_metric(folder):
    def millimetres(pose):
        return np.block([[pose[:3, :3], 1000 * pose[:3, 3:]], [pose[3:]]])

    frames = frames_of(folder, millimetres)
    assert "112 m apart; convert the translations to metres" in str(pose_convention_hint(frames))
    with pytest.raises(InputError, match="the poses look not metric"):
        view_tuples(PosedFolder(folder), 3, (0.1, 5.0))


def test_photos_turned_without_their_intrinsics_are_named(folder):
    frames = frames_of(folder)
    turned = [replace(frame, size=frame.size[::-1]) for frame in frames]
    hint = pose_convention_hint(turned)
    assert hint is not None and "meant for photos of 160x120, these are 120x160" in hint


def test_poses_in_centimetres_are_called_not_metric(folder):
    def in_centimetres(pose: np.ndarray) -> np.ndarray:
        return pose * np.block([[np.ones((3, 3)), np.full((3, 1), 100.0)], [np.ones((1, 4))]])

    hint = pose_convention_hint(frames_of(folder, in_centimetres))
    assert hint is not None and "look not metric" in hint


def test_the_refusal_of_a_scene_without_overlap_names_the_convention(folder, monkeypatch):
    frames = [
        Frame(f.name, f.size, f.intrinsics, f.world_from_cam @ OPENCV_FROM_OPENGL, no_pixels)
        for f in looking_at_a_table(5)
    ]
    scene = PosedFolder(folder)
    monkeypatch.setattr(scene, "_frames", frames)
    with pytest.raises(InputError, match=r"no photo overlaps its sources .* look in OpenGL axes"):
        view_tuples(scene, 3, (0.1, 5.0))


def test_a_single_frame_has_no_convention_to_tell(folder):
    assert pose_convention_hint(frames_of(folder)[:1]) is None


@pytest.mark.parametrize(
    ("factor", "remedy"),
    [(0.5, "half the size; double"), (2.0, "twice the size; halve")],
    ids=["half", "double"],
)
def test_photos_reveal_intrinsics_for_another_size(folder, factor, remedy):
    scaled = [
        replace(f, intrinsics=f.intrinsics * [[factor], [factor], [1]]) for f in frames_of(folder)
    ]
    hint = pose_convention_hint(scaled)
    assert hint is not None
    assert f"the intrinsics look meant for photos of {remedy}" in hint


def test_photos_that_match_under_no_reading_accuse_no_convention(folder, monkeypatch):
    """Of noise, the best reading beats the given one by chance but matches badly."""

    def badly(frames, pairs, readings, depth_range):
        return {reading: 0.4 - 0.1 * (reading == "as given") for reading in readings}

    monkeypatch.setattr("mvsam.data.check.poses._likeness_by_reading", badly)
    assert pose_convention_hint(frames_of(folder)) is None
