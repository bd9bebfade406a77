"""The rooms are the project's ground truth, so what they claim is checked here."""

import sys
from itertools import pairwise

import numpy as np
import pytest

from mvsam import rooms
from mvsam.errors import InputError, MissingExtraError
from mvsam.rooms.camera_path import CLEARANCE
from mvsam.types import Frame
from tests.reference.rays import first_hit

WIDTH, HEIGHT = 80, 64
FIXED = {
    "kind": "kitchen",
    "triangles": 7852,
    "position": [1.6835379942395923, 2.525992484710373, 1.5445460590163398],
    "mean": 151.046,
}
"""Of scene val/0000 at this size with three frames; the image mean in 8-bit levels."""


@pytest.fixture(scope="module")
def scenes() -> list[rooms.RoomScene]:
    return [rooms.scene("val", i, 3, WIDTH, HEIGHT) for i in range(4)]


def reproject(source: Frame, target: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where each pixel of source lies in target: column, row and depth there, by NumPy."""
    width, height = source.size
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    depth = source.depth
    assert depth is not None
    rays = (
        np.stack([column, row, np.ones_like(column)], axis=-1) @ np.linalg.inv(source.intrinsics).T
    )
    world = (rays * depth[..., None]) @ source.world_from_cam[:3, :3].T + source.world_from_cam[
        :3, 3
    ]
    local = (world - target.world_from_cam[:3, 3]) @ target.world_from_cam[:3, :3]
    pixel = local @ target.intrinsics.T
    return pixel[..., 0] / pixel[..., 2], pixel[..., 1] / pixel[..., 2], local[..., 2]


def landed(source: Frame, target: Frame):
    """Pixels of source seen by target at the same depth, and the target pixels they fall on."""
    column, row, depth = reproject(source, target)
    width, height = target.size
    inside = (depth > 0) & (column > 1) & (column < width - 1) & (row > 1) & (row < height - 1)
    i, j = row[inside].astype(int), column[inside].astype(int)
    there = target.depth
    assert there is not None
    same = np.abs(there[i, j] - depth[inside]) < 0.03 * depth[inside]
    return inside, i, j, same


def test_a_scene_is_the_same_twice_and_in_any_order(scenes):
    again = rooms.scene("val", 0, 3, WIDTH, HEIGHT)
    for index in (2, 0):
        first, second = scenes[0].frame(index), again.frame(index)
        np.testing.assert_array_equal(first.image, second.image)
        np.testing.assert_array_equal(first.depth, second.depth)
        np.testing.assert_array_equal(first.labels, second.labels)
        np.testing.assert_array_equal(first.world_from_cam, second.world_from_cam)


def test_scene_zero_has_not_changed(scenes):
    """Trained weights and published scores rest on these very rooms."""
    assert scenes[0].room.kind == FIXED["kind"]
    assert len(scenes[0].room.triangles) == FIXED["triangles"]
    np.testing.assert_allclose(
        scenes[0].cameras[0].world_from_cam[:3, 3], FIXED["position"], atol=1e-6
    )
    assert abs(float(scenes[0].frame(0).image.mean()) - FIXED["mean"]) < 0.5


def test_scenes_differ_between_indices_and_splits(scenes):
    other = rooms.scene("train", 0, 3, WIDTH, HEIGHT)
    positions = [s.cameras[0].world_from_cam for s in (scenes[0], scenes[1], other)]
    assert not np.allclose(positions[0], positions[1])
    assert not np.allclose(positions[0], positions[2])


def test_frames_have_the_promised_types_and_sizes(scenes):
    frame = scenes[0].frame(0)
    assert frame.size == (WIDTH, HEIGHT)
    depth, labels = frame.depth, frame.labels
    assert depth is not None and labels is not None
    assert frame.image.shape == (HEIGHT, WIDTH, 3) and frame.image.dtype == np.uint8
    assert depth.shape == labels.shape == (HEIGHT, WIDTH)
    assert depth.dtype == np.float32 and labels.dtype == np.uint8
    assert ((labels < 20) | (labels == 255)).all()


def test_every_pixel_has_a_depth_within_a_room(scenes):
    for scene in scenes:
        for index in range(len(scene)):
            depth = scene.frame(index).depth
            assert np.isfinite(depth).all() and depth.min() > 0.2 and depth.max() < 12


def test_depth_is_the_z_of_the_first_triangle_on_the_ray(scenes):
    scene, frame = scenes[1], scenes[1].frame(0)
    rotation, origin = frame.world_from_cam[:3, :3], frame.world_from_cam[:3, 3]
    for row, column in [(5, 7), (40, 33), (60, 75)]:
        direction = rotation @ np.linalg.solve(frame.intrinsics, [column + 0.5, row + 0.5, 1.0])
        triangle, distance = first_hit(scene.room.triangles, origin, direction)
        # The direction's camera z is one, so its multiple is the z-depth; float32 rays.
        assert frame.depth[row, column] == pytest.approx(distance, rel=1e-4)
        assert frame.labels[row, column] == scene.room.labels[triangle]


def test_true_depth_carries_one_view_onto_another(scenes):
    for scene in scenes:
        inside, _, _, same = landed(scene.frame(0), scene.frame(1))
        assert inside.mean() > 0.5, "neighbouring views overlap"
        # The rest is hidden in the other view or lies within a pixel of an edge.
        assert same.mean() > 0.8


def test_reprojected_pixels_keep_label_and_color(scenes):
    for scene in scenes:
        source, target = scene.frame(0), scene.frame(1)
        inside, i, j, same = landed(source, target)
        labels, others = source.labels[inside][same], target.labels[i, j][same]
        assert (labels == others).mean() > 0.93
        colors = source.image[inside][same].astype(float)
        difference = np.abs(colors - target.image[i, j][same])
        # Exposure, white balance and noise change; a wrong pose would give about 40 levels.
        assert np.median(difference) < 14


def test_all_twenty_classes_occur_in_the_first_nineteen_train_rooms():
    found: set[int] = set()
    for index in range(19):
        found |= set(rooms.scene("train", index).room.labels.tolist())
    assert found == {*range(20), 255}


def test_cameras_keep_their_distance_and_stay_inside(scenes):
    directions = np.random.default_rng(0).normal(size=(3, 400)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=0)
    for scene in scenes:
        for camera in scene.cameras:
            position = camera.world_from_cam[:3, 3]
            assert scene.room.contains(position[None]).all()
            origins = np.broadcast_to(position[:, None].astype(np.float32), directions.shape)
            # The path itself was checked with other, fewer rays; thin legs may slip through.
            assert np.percentile(scene.room.nearest(origins, directions), 2) > 0.9 * CLEARANCE


def test_baselines_run_from_a_video_to_some_strides_and_wide_ones_turn_towards_the_same_thing():
    baselines, turns = [], []
    for index in range(24):
        poses = [c.world_from_cam for c in rooms.scene("val", index, 3, 32, 24).cameras]
        for before, after in pairwise(poses):
            baselines.append(np.linalg.norm(after[:3, 3] - before[:3, 3]))
            turns.append(np.degrees(np.arccos(before[:3, 2] @ after[:3, 2])))
    assert 0.02 < min(baselines) < 0.07 and 0.3 < max(baselines) < 0.9
    assert max(turns) > 5 and max(turns) < 35


def turns(split: str) -> list[float]:
    """Degrees between the directions of neighbouring frames of 12 rooms."""
    paths = [rooms.scene(split, index, 3, 32, 24).cameras for index in range(12)]
    directions = [[camera.world_from_cam[:3, 2] for camera in path] for path in paths]
    pairs = [pair for path in directions for pair in pairwise(path)]
    return [float(np.degrees(np.arccos(here @ there))) for here, there in pairs]


def test_wide_paths_turn_as_single_photos_do():
    wide = turns("wide")
    assert np.median(wide) > 2 * np.median(turns("train"))
    assert 12 < np.median(wide) < 35 and max(wide) < 75


def test_paths_around_a_thing_look_down_from_far_apart():
    poses = [
        [camera.world_from_cam for camera in rooms.scene("around", index, 3, 32, 24).cameras]
        for index in range(12)
    ]
    steps = [
        np.linalg.norm(there[:3, 3] - here[:3, 3])
        for path in poses
        for here, there in pairwise(path)
    ]
    down = [np.degrees(np.arcsin(-pose[2, 2])) for path in poses for pose in path]
    assert 0.3 < np.median(steps) < 1.2
    assert np.percentile(down, 75) > 18


def test_every_other_room_around_which_one_walks_is_bare():
    kinds = [rooms.scene("around", index).room.kind for index in range(6)]
    assert kinds[::2] == ["bare"] * 3
    assert set(kinds[1::2]) != {"bare"}


def test_poses_are_rotations_with_the_sky_above(scenes):
    for camera in scenes[0].cameras:
        rotation = camera.world_from_cam[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1)
        assert rotation[2, 1] < -0.7, "the camera's down points to the floor"


def test_views_name_every_frame_once_as_reference(scenes):
    views = scenes[0].views()
    assert [view[0] for view in views] == [0, 1, 2]
    assert all(sorted(view) == [0, 1, 2] for view in views)


def test_intrinsics_scale_with_the_size():
    small = rooms.scene("val", 5, 3, 160, 128).frame(0).intrinsics
    large = rooms.scene("val", 5, 3, 320, 256).frame(0).intrinsics
    np.testing.assert_allclose(2 * small[:2], large[:2])


@pytest.mark.parametrize(("split", "index"), [("val", 100), ("test", -1), ("train", -1)])
def test_an_index_out_of_range_is_refused(split, index):
    with pytest.raises(InputError, match=f"rooms:{split} has no scene {index}"):
        rooms.scene(split, index)


def test_an_unknown_split_is_refused_with_the_known_ones():
    with pytest.raises(InputError, match="train, wide, around, val, test"):
        rooms.scene("dev", 0)


def test_a_frame_out_of_range_is_refused(scenes):
    with pytest.raises(InputError, match="has no frame 3"):
        scenes[0].frame(3)


def test_missing_embreex_is_named_with_its_install_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "embreex.rtcore_scene", None)
    with pytest.raises(MissingExtraError, match=r"embreex: pip install 'mvsam\[rooms\]'"):
        _ = rooms.scene("val", 1).room
