"""Cameras against measured depth: the right reading is found, whatever was broken."""

import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from mvsam.data.check.depth import depth_verdict
from mvsam.data.check.readings import HALF_SIZE
from mvsam.data.check.report import report_scene
from mvsam.data.readers.posed_folder import PosedFolder
from mvsam.errors import InputError
from mvsam.types import Frame
from tests.synthetic import camera_intrinsics, camera_pose, render, write_posed_folder

RANGE = (0.1, 5.0)


@pytest.fixture(scope="module")
def frames(tmp_path_factory) -> list[Frame]:
    """Ten views that stride and turn, so that every wrong reading is far off."""
    folder = tmp_path_factory.mktemp("box")
    write_posed_folder(folder, num_frames=10)
    scene = PosedFolder(folder)
    return [scene.frame(index) for index in range(len(scene))]


def changed(frames, pose=lambda p: p, intrinsics=lambda k: k) -> list[Frame]:
    return [
        replace(f, world_from_cam=pose(f.world_from_cam), intrinsics=intrinsics(f.intrinsics))
        for f in frames
    ]


def moved_by_thousand(pose: np.ndarray) -> np.ndarray:
    result = pose.copy()
    result[:3, 3] *= 1000
    return result


def left_handed(pose: np.ndarray) -> np.ndarray:
    negate_y = np.diag([1.0, -1.0, 1.0, 1.0])
    return negate_y @ pose @ negate_y


def turned_back(pose: np.ndarray) -> np.ndarray:
    result = pose.copy()
    result[:3, :3] = pose[:3, :3].T
    return result


def test_right_cameras_fit(frames):
    verdict = depth_verdict(frames, RANGE)
    assert verdict.fits
    assert verdict.agreement["as given"] > 0.9


@pytest.mark.parametrize(
    "pose, remedy",
    [
        (np.linalg.inv, "world-to-camera; invert"),
        (lambda pose: pose @ np.diag([1.0, -1, -1, 1]), "in OpenGL axes"),
        (moved_by_thousand, "millimetres"),
        (turned_back, "transposed rotations"),
        (left_handed, "left-handed"),
    ],
    ids=["inverse", "opengl", "millimetres", "transposed", "left-handed"],
)
def test_wrong_poses_are_named_with_the_remedy(frames, pose, remedy):
    verdict = depth_verdict(changed(frames, pose), RANGE)
    assert verdict.fits is False
    assert remedy in verdict.sentence


@pytest.mark.parametrize("factor", [100.0, 0.3, 0.5, 2.0, 3.0])
def test_poses_in_another_unit_are_named_with_a_scale_to_give(frames, factor):
    def longer(pose: np.ndarray) -> np.ndarray:
        return pose * np.block([[np.ones((3, 3)), np.full((3, 1), factor)], [np.ones((1, 4))]])

    verdict = depth_verdict(changed(frames, longer), RANGE)
    assert verdict.fits is False
    (unit,) = re.findall(
        r"of about (\S+) m if the depth's is right; give --scale", verdict.sentence
    )
    assert float(unit) == pytest.approx(1 / factor, rel=0.04)


def test_intrinsics_of_half_the_size_are_named(frames):
    halved = changed(frames, intrinsics=lambda k: k * np.array([[0.5], [0.5], [1]]))
    verdict = depth_verdict(halved, RANGE)
    assert verdict.fits is False and HALF_SIZE in verdict.sentence


def test_poses_of_other_photos_fit_nothing(frames):
    dice = np.random.default_rng(0)
    wild = []
    for frame in frames:
        pose = np.eye(4)
        pose[:3, :3] = np.linalg.qr(dice.normal(size=(3, 3)))[0]
        pose[:3, :3] *= np.linalg.det(pose[:3, :3])
        pose[:3, 3] = dice.normal(size=3)
        wild.append(replace(frame, world_from_cam=pose))
    verdict = depth_verdict(wild, RANGE)
    assert verdict.fits is False and "no convention fits" in verdict.sentence


def test_too_little_depth_is_no_verdict(frames):
    assert depth_verdict(frames[:2], RANGE).fits is None
    without = [replace(frame, load_depth=None) for frame in frames]
    assert depth_verdict(without, RANGE).fits is None


def test_maps_without_depth_accuse_nobody(frames):
    empty = [replace(f, load_depth=lambda f=f: np.zeros_like(f.depth)) for f in frames]
    verdict = depth_verdict(empty, RANGE)
    assert verdict.fits is None and "empty" in verdict.sentence
    assert depth_verdict([frames[0], *empty[1:]], RANGE).fits is None
    of_keyframes = [frame if n % 3 == 0 else empty[n] for n, frame in enumerate(frames)]
    assert depth_verdict(of_keyframes, RANGE).fits is not False


def test_a_report_counts_what_the_folder_holds(tmp_path):
    truth = write_posed_folder(tmp_path, num_frames=6)
    report = report_scene(PosedFolder(tmp_path), RANGE)
    assert (report.num_frames, report.num_depth, report.num_labels) == (6, 6, 6)
    assert report.sizes == [(64, 48)]
    steps = np.linalg.norm(np.diff([v.world_from_cam[:3, 3] for v in truth], axis=0), axis=1)
    np.testing.assert_allclose(report.baselines, [steps.min(), np.median(steps), steps.max()])
    np.testing.assert_allclose(report.turns, 3.0, atol=1e-4)
    assert report.depth_coverage == 1.0
    labels = np.stack([view.labels for view in truth])
    assert report.label_shares["floor"] == pytest.approx((labels == 1).mean())
    assert not report.is_suspicious


def test_a_report_names_a_photo_that_is_cut_off(tmp_path):
    write_posed_folder(tmp_path, num_frames=6)
    photo = sorted((tmp_path / "color").iterdir())[4]
    photo.write_bytes(photo.read_bytes()[:-200])
    with pytest.raises(InputError, match=rf"{photo.name}: the photo cannot be read"):
        report_scene(PosedFolder(tmp_path), RANGE)


def recording(num_frames: int, step: float) -> list[Frame]:
    """`step` is how far from one pose of the synthetic walk to the next."""
    size = (64, 48)
    intrinsics = camera_intrinsics(size)
    frames = []
    for index in range(num_frames):
        pose = camera_pose(index * step)
        image, depth, _ = render(size, intrinsics, pose)
        load_image, load_depth = (lambda i=image: i), (lambda d=depth: d)
        frames.append(Frame(str(index), size, intrinsics, pose, load_image, load_depth))
    return frames


def test_cameras_that_stand_still_are_no_verdict():
    verdict = depth_verdict(recording(5, step=0), RANGE)
    assert verdict.fits is None
    assert "hardly move, 0.0 mm from frame to frame" in verdict.sentence


@pytest.mark.parametrize("wrong", [np.eye(4), np.diag([1.0, -1, -1, 1])], ids=["right", "opengl"])
def test_steps_too_small_to_tell_name_the_reading_that_fits_as_well(wrong):
    slow = changed(recording(12, step=0.05), lambda pose: pose @ wrong)
    verdict = depth_verdict(slow, RANGE)
    assert verdict.fits is None
    assert re.search("(99|100)% if the cameras are in OpenGL axes", verdict.sentence)


@pytest.mark.parametrize(
    ("factor", "named"), [(1.5, 1.5), (3.0, 3.0), (1 / 3, 0.33), (1 / 1.5, 0.67)]
)
def test_intrinsics_of_other_sizes_are_named_with_the_factor(frames, factor, named):
    scaled = changed(frames, intrinsics=lambda k: k / np.array([[factor], [factor], [1]]))
    verdict = depth_verdict(scaled, RANGE)
    assert verdict.fits is False
    assert f"multiply their first two rows by {named:g}" in verdict.sentence


def test_a_remedy_that_leaves_surfaces_apart_is_only_the_closest(frames):
    """Depth that is wrong in two of five places: even the right cameras do not fit well."""

    def spoilt(frame: Frame) -> np.ndarray:
        depth = frame.load_depth().copy() if frame.load_depth else np.zeros((48, 64))
        depth[np.random.default_rng(int(frame.name)).random(depth.shape) < 0.25] *= 0.8
        return depth

    inverted = changed(frames, np.linalg.inv)
    verdict = depth_verdict([replace(f, load_depth=partial(spoilt, f)) for f in inverted], RANGE)
    assert verdict.fits is False
    assert "no convention we know fits well; the closest: the cameras are world" in verdict.sentence
