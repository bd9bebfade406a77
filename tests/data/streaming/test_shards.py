"""Frames of scans kept at the training size."""

from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from mvsam.data.dataset import make_targets, make_views
from mvsam.data.readers.posed_folder import PosedFolder
from mvsam.data.streaming import shards
from mvsam.data.streaming.shards import ShardedScene
from mvsam.data.transforms import crop_to_shape
from mvsam.data.view_rules import PrescribedScene
from tests.synthetic import write_posed_folder

SIZE = (32, 32)


@pytest.fixture
def scene(tmp_path: Path) -> PosedFolder:
    write_posed_folder(tmp_path / "room", 5, (72, 54))
    return PosedFolder(tmp_path / "room")


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("*/*"))


@pytest.mark.parametrize("crop", [False, True])
def test_a_kept_frame_gives_the_picture_of_the_whole_one(scene, tmp_path: Path, crop: bool):
    kept = ShardedScene(scene, tmp_path / "cache", SIZE, crop)
    for index in (3, 0):
        frame = scene.frame(index)
        frame = crop_to_shape(frame, SIZE) if crop else frame
        expected, actual = make_views([frame], SIZE), make_views([kept.frame(index)], SIZE)
        assert (actual.images - expected.images).abs().max() <= 0.5 / 255 + 1e-6
        np.testing.assert_allclose(actual.intrinsics, expected.intrinsics, rtol=1e-6)
        np.testing.assert_array_equal(actual.world_from_cam, expected.world_from_cam)
        truth, targets = make_targets(frame, SIZE), make_targets(kept.frame(index), SIZE)
        assert (targets.labels == truth.labels).all()
        np.testing.assert_allclose(targets.depth, truth.depth, atol=0.51e-3)


def test_what_is_kept_is_not_decoded_again(scene, tmp_path: Path):
    expected = ShardedScene(scene, tmp_path / "cache", SIZE).frame(1).image

    def refuse(*_):
        raise AssertionError("decoded again")

    with mock.patch.object(shards, "area_resize", refuse):
        actual = ShardedScene(scene, tmp_path / "cache", SIZE).frame(1).image
    np.testing.assert_array_equal(actual, expected)


def test_shards_hold_the_frames_of_the_tuples_alone(scene, tmp_path: Path):
    kept = ShardedScene(PrescribedScene(scene, [(4, 1), (1, 2)]), tmp_path / "cache", SIZE)
    with mock.patch.object(shards, "SHARD_FRAMES", 2):
        assert not files(tmp_path / "cache")
        assert kept.frame(1).image.shape == (32, 32, 3)
        assert files(tmp_path / "cache") == ["0000.npz"]  # frames 1 and 2
        pose = kept.frame(4).world_from_cam
        np.testing.assert_array_equal(pose, scene.frame(4).world_from_cam)
        assert len(files(tmp_path / "cache")) == 1, "a pose needs no shard"
        kept.frame(4).depth  # noqa: B018
        assert files(tmp_path / "cache") == ["0000.npz", "0001.npz"]


def test_other_cameras_have_other_shards(scene, tmp_path: Path):
    ShardedScene(scene, tmp_path / "cache", SIZE).frame(0).image  # noqa: B018
    write_posed_folder(tmp_path / "room", 5, (72, 54), baseline=0.2)
    moved = PosedFolder(tmp_path / "room")
    again = ShardedScene(moved, tmp_path / "cache", SIZE).frame(2)
    expected = make_views([moved.frame(2)], SIZE).images
    assert (make_views([again], SIZE).images - expected).abs().max() <= 0.5 / 255 + 1e-6
    assert len(list((tmp_path / "cache").iterdir())) == 2


def test_labels_that_come_later_are_seen(tmp_path: Path):
    write_posed_folder(tmp_path / "room", 2, (72, 54), labels=False)
    ShardedScene(PosedFolder(tmp_path / "room"), tmp_path / "cache", SIZE).frame(0).image  # noqa: B018
    write_posed_folder(tmp_path / "room", 2, (72, 54))
    frame = ShardedScene(PosedFolder(tmp_path / "room"), tmp_path / "cache", SIZE).frame(0)
    assert frame.labels is not None


def test_frames_without_depth_or_labels_stay_so(tmp_path: Path):
    write_posed_folder(tmp_path / "room", 2, (72, 54), depth=False, labels=False)
    frame = ShardedScene(PosedFolder(tmp_path / "room"), tmp_path / "cache", SIZE).frame(0)
    assert frame.image.shape == (32, 32, 3) and frame.depth is None and frame.labels is None
