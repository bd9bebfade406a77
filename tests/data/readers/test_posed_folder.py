import json
import pickle

import numpy as np
import pytest
from PIL import Image

from mvsam.data.readers.posed_folder import PosedFolder
from tests.synthetic import depth_of, labels_of, write_posed_folder


@pytest.mark.parametrize("extension", ["png", "jpg", "JPG", "jpeg"])
def test_frames_come_sorted_by_name_with_the_size_of_their_photo(tmp_path, extension):
    truth = write_posed_folder(tmp_path, num_frames=3, extension=extension)
    scene = PosedFolder(tmp_path)
    assert [scene.frame(i).name for i in range(len(scene))] == [view.name for view in truth]
    assert all(scene.frame(i).size == (64, 48) for i in range(3))
    assert scene.name == tmp_path.name


def test_pixels_depth_labels_and_poses_are_those_written(tmp_path):
    truth = write_posed_folder(tmp_path)
    frame = PosedFolder(tmp_path).frame(1)
    np.testing.assert_array_equal(frame.image, truth[1].image)
    np.testing.assert_array_equal(labels_of(frame), truth[1].labels)
    np.testing.assert_allclose(depth_of(frame), truth[1].depth, atol=0.5e-3)  # whole millimetres
    assert depth_of(frame).dtype == np.float32
    np.testing.assert_allclose(frame.world_from_cam, truth[1].world_from_cam, atol=1e-8)


def test_half_a_pixel_is_added_once_to_the_principal_point(tmp_path):
    write_posed_folder(tmp_path)
    (tmp_path / "intrinsics.txt").write_text("50 0 31.5\n0 51 23.5\n0 0 1\n")
    expected = [[50, 0, 32], [0, 51, 24], [0, 0, 1]]
    np.testing.assert_array_equal(PosedFolder(tmp_path).frame(2).intrinsics, expected)


def test_true_depth_carries_the_colours_of_one_photo_into_another(tmp_path):
    """Catches a wrong half pixel, a wrong axis and a wrong unit at once."""
    write_posed_folder(tmp_path, size=(160, 120))
    scene = PosedFolder(tmp_path)
    reference, source = scene.frame(0), scene.frame(2)
    rows, columns = np.mgrid[5:115:7, 5:155:7]
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(rows.shape)], axis=-1)
    rays = pixels @ np.linalg.inv(reference.intrinsics).T
    points = rays * depth_of(reference)[rows, columns][..., None]
    source_from_reference = np.linalg.inv(source.world_from_cam) @ reference.world_from_cam
    seen = points @ source_from_reference[:3, :3].T + source_from_reference[:3, 3]
    projected = seen @ source.intrinsics.T
    position = projected[..., :2] / projected[..., 2:]
    inside = ((position > 1) & (position < [159, 119])).all(-1)
    assert inside.mean() > 0.5
    # Linear interpolation between pixel centres, which lie at halves.
    low = np.floor(position[inside] - 0.5).astype(int)
    weight = position[inside] - 0.5 - low
    image = source.image.astype(float)
    corners = [
        image[low[:, 1] + dy, low[:, 0] + dx]
        * (weight[:, :1] if dx else 1 - weight[:, :1])
        * (weight[:, 1:] if dy else 1 - weight[:, 1:])
        for dx in (0, 1)
        for dy in (0, 1)
    ]
    error = np.abs(sum(corners) - reference.image[rows, columns][inside])
    # Half a pixel of error costs 2 grey values here on average; rounding costs about 0.5.
    assert error.mean() < 0.8


def test_photos_of_different_sizes_have_their_own_intrinsics(tmp_path):
    truth = write_posed_folder(tmp_path, num_frames=2, depth=False, labels=False)
    Image.fromarray(truth[1].image).resize((32, 24)).save(tmp_path / "color" / "0001.png")
    (tmp_path / "intrinsics.txt").unlink()
    (tmp_path / "intrinsics").mkdir()
    (tmp_path / "intrinsics/0000.txt").write_text("50 0 31.5\n0 51 23.5\n0 0 1\n")
    (tmp_path / "intrinsics/0001.txt").write_text("25 0 15.5\n0 25 11.5\n0 0 1\n")
    scene = PosedFolder(tmp_path)
    assert [scene.frame(i).size for i in range(2)] == [(64, 48), (32, 24)]
    assert [scene.frame(i).intrinsics[0, 2] for i in range(2)] == [32.0, 16.0]


def test_depth_and_labels_are_optional_and_may_exist_for_some_photos(tmp_path):
    write_posed_folder(tmp_path / "bare", depth=False, labels=False)
    bare = PosedFolder(tmp_path / "bare")
    assert bare.frame(0).depth is None
    assert bare.frame(0).labels is None
    write_posed_folder(tmp_path / "some")
    (tmp_path / "some/depth/0001.png").unlink()
    some = PosedFolder(tmp_path / "some")
    assert some.frame(1).depth is None
    assert some.frame(2).depth is not None


def test_zero_millimetres_stay_unknown(tmp_path):
    write_posed_folder(tmp_path)
    Image.fromarray(np.zeros((48, 64), np.uint16)).save(tmp_path / "depth/0000.png")
    assert depth_of(PosedFolder(tmp_path).frame(0)).max() == 0


def test_palette_label_maps_are_read_as_numbers(tmp_path):
    truth = write_posed_folder(tmp_path)
    picture = Image.fromarray(truth[0].labels)
    picture.putpalette([255 - v // 3 for v in range(768)])
    picture.save(tmp_path / "labels/0000.png")
    np.testing.assert_array_equal(labels_of(PosedFolder(tmp_path).frame(0)), truth[0].labels)


def test_grey_and_transparent_photos_become_rgb(tmp_path):
    truth = write_posed_folder(tmp_path)
    Image.fromarray(truth[0].image).convert("L").save(tmp_path / "color/0000.png")
    Image.fromarray(truth[1].image).convert("RGBA").save(tmp_path / "color/0001.png")
    scene = PosedFolder(tmp_path)
    assert scene.frame(0).image.shape == (48, 64, 3)
    np.testing.assert_array_equal(scene.frame(1).image, truth[1].image)


def test_views_are_none_without_views_txt_and_indices_with_it(tmp_path):
    write_posed_folder(tmp_path)
    assert PosedFolder(tmp_path).views() is None
    (tmp_path / "views.txt").write_text("# comment\n\n0002 0000 0001  # best first\n0000 0002\n")
    assert PosedFolder(tmp_path).views() == [(2, 0, 1), (0, 2)]


def test_classes_json_replaces_scannets_classes(tmp_path):
    write_posed_folder(tmp_path)
    assert len(PosedFolder(tmp_path).classes) == 20
    table = [{"name": "plane", "color": [1, 2, 3]}, {"name": "ground", "color": [4, 5, 6]}]
    (tmp_path / "classes.json").write_text(json.dumps(table))
    scene = PosedFolder(tmp_path)
    assert scene.classes.names == ("plane", "ground")
    assert set(np.unique(labels_of(scene.frame(0)))) <= {0, 1, 255}


def test_opening_reads_no_pixels(tmp_path, monkeypatch):
    write_posed_folder(tmp_path)
    monkeypatch.setattr(Image.Image, "load", lambda self: pytest.fail("pixels were decoded"))
    PosedFolder(tmp_path)


def test_hidden_and_foreign_files_beside_the_photos_are_ignored(tmp_path):
    write_posed_folder(tmp_path)
    (tmp_path / "color/.0009.png").write_bytes(b"junk")
    (tmp_path / "color/Thumbs.db").write_bytes(b"junk")
    assert len(PosedFolder(tmp_path)) == 3


def test_frames_can_be_sent_to_worker_processes(tmp_path):
    truth = write_posed_folder(tmp_path)
    frame = pickle.loads(pickle.dumps(PosedFolder(tmp_path).frame(0)))
    np.testing.assert_array_equal(frame.image, truth[0].image)
