"""What the exporter writes is what design.md and the posed-folder loader expect."""

import numpy as np
import pytest
from PIL import Image

from mvsam import rooms


@pytest.fixture(scope="module")
def scene() -> rooms.RoomScene:
    return rooms.scene("test", 3, 3, 64, 48)


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("rooms") / "room"
    rooms.export_posed_folder(scene, folder)
    return folder


def test_every_frame_has_its_four_files(scene, folder):
    names = {scene.frame(i).name for i in range(len(scene))}
    for kind, ending in [("color", "png"), ("depth", "png"), ("labels", "png"), ("poses", "txt")]:
        assert {path.name for path in (folder / kind).iterdir()} == {f"{n}.{ending}" for n in names}


def test_pictures_come_back_exactly_and_depth_to_half_a_millimetre(scene, folder):
    frame = scene.frame(1)
    color = np.array(Image.open(folder / "color" / f"{frame.name}.png"))
    np.testing.assert_array_equal(color, frame.image)
    labels = np.array(Image.open(folder / "labels" / f"{frame.name}.png"))
    np.testing.assert_array_equal(labels, frame.labels)
    depth = Image.open(folder / "depth" / f"{frame.name}.png")
    assert depth.mode == "I;16"
    assert np.abs(np.array(depth) / 1000 - frame.depth).max() <= 0.00051


def test_calibration_is_written_for_integer_pixel_centres(scene, folder):
    written = np.loadtxt(folder / "intrinsics.txt")
    ours = scene.frame(0).intrinsics
    np.testing.assert_allclose(written[:2, 2], ours[:2, 2] - 0.5, rtol=1e-8)
    np.testing.assert_allclose(written[[0, 1], [0, 1]], ours[[0, 1], [0, 1]], rtol=1e-8)


def test_poses_are_camera_to_world(scene, folder):
    frame = scene.frame(2)
    written = np.loadtxt(folder / "poses" / f"{frame.name}.txt")
    np.testing.assert_allclose(written, frame.world_from_cam, atol=1e-8)


def test_views_file_lists_each_tuple_by_names(scene, folder):
    lines = (folder / "views.txt").read_text().splitlines()
    tuples = [line.split() for line in lines if not line.startswith("#")]
    assert tuples == [[scene.frame(i).name for i in view] for view in scene.views()]


def test_preview_shows_image_depth_and_labels_side_by_side(scene):
    palette = np.arange(60, dtype=np.uint8).reshape(20, 3)
    sheet = np.array(rooms.preview_sheet([scene, scene], palette))
    assert sheet.shape == (2 * 48, 3 * 64, 3)
    np.testing.assert_array_equal(sheet[:48, :64], scene.frame(0).image)
    labels = scene.frame(0).labels
    known = labels < 20
    np.testing.assert_array_equal(sheet[:48, 128:][known], palette[labels[known]])
    assert (sheet[:48, 128:][~known] == 0).all()
