"""A procedural room, written in each format, comes back as it was."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import torch

import mvsam
from mvsam import rooms
from mvsam.data.dataset import make_views
from mvsam.data.formats import find_format, open_scene
from mvsam.data.readers import seven_scenes
from mvsam.rooms.camera_path import Camera
from mvsam.rooms.render import render
from mvsam.types import Frame, Model
from tests.data.readers.layouts import LAYOUTS, Layout
from tests.synthetic import depth_of, labels_of

NUM_FRAMES = 3


@cache
def room(size: tuple[int, int], camera: tuple[float, ...] | None) -> rooms.RoomScene:
    scene = rooms.scene("test", 3, NUM_FRAMES, *size)
    if camera is not None:
        intrinsics = np.array(camera).reshape(3, 3)
        scene.cameras = [replace(c, intrinsics=intrinsics) for c in scene.cameras]
    return scene


def truth_of(layout: Layout) -> list[Frame]:
    camera = None if layout.camera is None else tuple(layout.camera.ravel().tolist())
    scene = room(layout.size, camera)
    return [scene.frame(index) for index in range(NUM_FRAMES)]


def seen_by_depth_camera(frames: list[Frame]) -> list[Frame]:
    """7-Scenes stores the depth of another camera than its photos'."""
    scene = room((640, 480), tuple(seven_scenes.COLOR_CAMERA.ravel().tolist()))

    def depth(pose: np.ndarray) -> np.ndarray:
        camera = Camera(seven_scenes.DEPTH_CAMERA, pose, 640, 480)
        return render(scene.room, camera).depth

    poses = [frame.world_from_cam @ seven_scenes.COLOR_FROM_DEPTH for frame in frames]
    return [
        replace(frame, load_depth=partial(depth, pose))
        for frame, pose in zip(frames, poses, strict=True)
    ]


@cache
def reopened(name: str, folder) -> tuple[list[Frame], list[Frame]]:
    """(what was written, what came back)."""
    layout = LAYOUTS[name]
    truth = truth_of(layout)
    layout.write(seen_by_depth_camera(truth) if name == "7-scenes" else truth, folder)
    assert find_format(folder) == name.split()[0]
    scene = open_scene(folder)
    assert len(scene) == NUM_FRAMES
    return truth, [scene.frame(index) for index in range(NUM_FRAMES)]


@pytest.fixture(scope="module", params=LAYOUTS)
def case(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("41069021")
    return LAYOUTS[request.param], *reopened(request.param, folder)


def test_images_are_identical_or_good_jpegs(case):
    layout, truth, frames = case
    for before, after in zip(truth, frames, strict=True):
        if layout.is_lossless:
            np.testing.assert_array_equal(after.image, before.image)
        error = (after.image.astype(float) - before.image) ** 2
        assert 10 * np.log10(255**2 / max(error.mean(), 1e-9)) >= 38


def test_cameras_come_back_to_the_formats_precision(case):
    layout, truth, frames = case
    for before, after in zip(truth, frames, strict=True):
        np.testing.assert_allclose(
            after.world_from_cam, before.world_from_cam, atol=2 * layout.pose_step
        )
        np.testing.assert_allclose(after.intrinsics, before.intrinsics, rtol=1e-6)


def test_depth_comes_back_within_one_step(case):
    layout, truth, frames = case
    for before, after in zip(truth, frames, strict=True):
        if layout.depth_step is None:
            assert after.depth is None
        elif layout is LAYOUTS["7-scenes"]:
            known = depth_of(after) > 0
            error = np.abs(depth_of(after) / depth_of(before) - 1)[known]
            assert known.mean() > 0.6 and np.median(error) < 0.01
        else:
            np.testing.assert_allclose(depth_of(after), depth_of(before), atol=layout.depth_step)


def test_labels_come_back_exactly(case):
    layout, truth, frames = case
    for before, after in zip(truth, frames, strict=True):
        if layout.has_labels:
            np.testing.assert_array_equal(labels_of(after), labels_of(before))
        else:
            assert after.labels is None


@pytest.fixture(scope="module")
def model() -> Model:
    """Embedded weights: a random model says nearly the same whatever it sees."""
    return mvsam.load("tiny")


def predicted_depth(model: Model, frames: list[Frame]) -> torch.Tensor:
    with torch.inference_mode():
        depth = model(make_views(frames, (64, 32))).depth
    assert depth is not None
    return depth


def change_of_depth(model: Model, before: list[Frame], after: list[Frame]) -> float:
    """Mean of the relative change."""
    first, second = (predicted_depth(model, frames) for frames in (before, after))
    return ((second - first).abs() / first).mean().item()


def test_predicted_depth_is_the_same_or_within_one_percent(case, model):
    layout, truth, frames = case
    limit = 0.0 if layout.is_lossless else 0.01
    assert change_of_depth(model, truth, frames) <= limit


@pytest.mark.parametrize("name", ["posed-folder", "icl-nuim", "7-scenes"])
@pytest.mark.parametrize("wrong", [np.diag([1.0, -1, -1, 1]), None], ids=["OpenGL", "inverse"])
def test_wrong_poses_change_predicted_depth_by_far_more(name, wrong, model):
    truth = truth_of(LAYOUTS[name])
    poses = [frame.world_from_cam for frame in truth]
    poses = [np.linalg.inv(pose) if wrong is None else pose @ wrong for pose in poses]
    pairs = zip(truth, poses, strict=True)
    frames = [replace(frame, world_from_cam=pose) for frame, pose in pairs]
    # Five times what is allowed above; the rest is the prior, which needs no poses.
    assert change_of_depth(model, truth, frames) > 0.05
