"""A procedural room, written in each format, comes back as it was."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import torch

from mvsam import rooms
from mvsam.data.dataset import make_views
from mvsam.data.formats import find_format, open_scene
from mvsam.data.readers import seven_scenes
from mvsam.rooms.camera_path import Camera
from mvsam.rooms.render import render
from mvsam.types import Frame
from tests.data.readers.layouts import LAYOUTS, Layout
from tests.small import small_model
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


def test_predicted_depth_is_the_same_or_within_one_percent(case):
    layout, truth, frames = case
    model = small_model("tiny").eval()
    with torch.inference_mode():
        before, after = (model(make_views(f, (64, 32))).depth for f in (truth, frames))
    assert before is not None and after is not None
    change = ((after - before).abs() / before).mean()
    assert change < (1e-4 if layout.is_lossless else 0.01)
