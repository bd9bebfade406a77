"""Folders of photos without poses: each photo is a scene, for models of single pictures."""

import shutil

import numpy as np
import pytest

from mvsam.data.catalog import open_data
from mvsam.data.readers.single_views import SingleViews
from mvsam.data.sampling import view_tuples
from mvsam.errors import InputError
from tests.synthetic import depth_of, labels_of, write_posed_folder


@pytest.fixture
def folder(tmp_path):
    truth = write_posed_folder(tmp_path / "nyu")
    shutil.rmtree(tmp_path / "nyu/poses")
    return tmp_path / "nyu", truth


def test_each_photo_is_a_scene_with_its_depth_and_labels(folder, caplog):
    path, truth = folder
    scenes = open_data(str(path))
    assert "3 photos taken alone" in caplog.text
    assert [scene.name for scene in scenes] == ["nyu/0000", "nyu/0001", "nyu/0002"]
    for scene, view in zip(scenes, truth, strict=True):
        assert len(scene) == 1
        frame = scene.frame(0)
        np.testing.assert_array_equal(frame.image, view.image)
        np.testing.assert_array_equal(labels_of(frame), view.labels)
        np.testing.assert_allclose(depth_of(frame), view.depth, atol=0.51e-3)
        np.testing.assert_allclose(frame.intrinsics, view.intrinsics)


def test_one_view_is_enough_for_them_and_stereo_is_refused(folder):
    scene = open_data(str(folder[0]))[1]
    assert view_tuples(scene, 1, (0.1, 5.0)) == ([(0,)], [])
    with pytest.raises(InputError, match="depth needs at least two posed photos, found 1"):
        view_tuples(scene, 3, (0.1, 5.0))


def test_they_may_lie_beside_posed_scenes(folder):
    path, _ = folder
    write_posed_folder(path.parent / "room")
    assert [len(scene) for scene in open_data(str(path.parent))] == [1, 1, 1, 3]


def test_names_are_left_out_or_are_the_only_ones(folder):
    path, _ = folder
    assert [s.name for s in SingleViews(path, without=["0000", "0002"])] == ["nyu/0001"]
    assert [s.name for s in SingleViews(path, only=["0002", "9999"])] == ["nyu/0002"]
    with pytest.raises(InputError, match="every photo is left out"):
        SingleViews(path, only=[])


def test_photos_alone_are_no_labelled_set(folder):
    path, _ = folder
    shutil.rmtree(path / "depth")
    shutil.rmtree(path / "labels")
    with pytest.raises(InputError, match="poses: this folder is missing"):
        open_data(str(path))
