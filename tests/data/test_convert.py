"""Scenes written in our two forms come back as they were."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from mvsam import rooms
from mvsam.cli import main
from mvsam.data.convert import write_nerfstudio, write_posed_folder
from mvsam.data.formats import open_scene
from mvsam.data.labels import SCANNET20, ClassTable
from mvsam.data.readers.listed import ListedScene
from mvsam.data.scaled import ScaledScene
from mvsam.errors import InputError
from tests.synthetic import depth_of, labels_of
from tests.synthetic import write_posed_folder as write_files


@pytest.fixture(scope="module")
def scene() -> rooms.RoomScene:
    return rooms.scene("test", 3, 3, 64, 48)


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    folder = tmp_path_factory.mktemp("rooms") / "room"
    assert list(write_posed_folder(scene, folder, "PNG")) == ["0000", "0001", "0002"]
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


@pytest.mark.parametrize("write", [write_posed_folder, write_nerfstudio])
def test_a_converted_scene_is_the_same_scene(scene, tmp_path, write):
    list(write(scene, tmp_path, "PNG"))
    again = open_scene(tmp_path)
    assert len(again) == len(scene)
    for index in range(len(scene)):
        before, after = scene.frame(index), again.frame(index)
        assert after.name == before.name
        np.testing.assert_array_equal(after.image, before.image)
        np.testing.assert_array_equal(labels_of(after), labels_of(before))
        np.testing.assert_allclose(depth_of(after), depth_of(before), atol=0.51e-3)
        np.testing.assert_allclose(after.world_from_cam, before.world_from_cam, atol=1e-7)
        np.testing.assert_allclose(after.intrinsics, before.intrinsics, rtol=1e-7)


@pytest.mark.parametrize("write", [write_posed_folder, write_nerfstudio])
def test_labels_keep_their_meaning(tmp_path, write):
    write_files(tmp_path / "mine")
    table = [{"name": f"thing {n}", "color": [n, n, n]} for n in range(30)]
    (tmp_path / "mine/classes.json").write_text(json.dumps(table))
    Image.fromarray(np.full((48, 64), 29, np.uint8)).save(tmp_path / "mine/labels/0001.png")
    list(write(open_scene(tmp_path / "mine"), tmp_path / "other", "PNG"))
    again = open_scene(tmp_path / "other")
    assert getattr(again, "classes", None) == getattr(open_scene(tmp_path / "mine"), "classes", 0)
    assert (labels_of(again.frame(1)) == 29).all()


def test_a_folder_with_poses_of_another_scale_is_refused_as_it_is(scene, tmp_path):
    next(write_posed_folder(scene, tmp_path))  # stopped after one of three
    before = sorted(tmp_path.rglob("*.*"))
    with pytest.raises(InputError, match=r"0000\.txt: is there with another pose"):
        list(write_posed_folder(ScaledScene(scene, 2.0), tmp_path))
    assert sorted(tmp_path.rglob("*.*")) == before
    list(write_posed_folder(scene, tmp_path))


def test_a_second_scale_is_written_anew_in_the_form_of_nerfstudio(scene, tmp_path):
    for scale in (1.0, 2.0):
        list(write_nerfstudio(ScaledScene(scene, scale), tmp_path))
        place = open_scene(tmp_path).frame(0).world_from_cam[:3, 3]
        np.testing.assert_allclose(place, scale * scene.frame(0).world_from_cam[:3, 3])


def test_a_skew_is_refused_where_it_would_be_lost(scene, tmp_path):
    frame = scene.frame(1)
    skew = np.array([[0, 0.5, 0], [0, 0, 0], [0, 0, 0]])
    skewed = replace(frame, intrinsics=frame.intrinsics + skew)
    scene = ListedScene("room", [scene.frame(0), skewed])
    with pytest.raises(InputError, match=r"room frame 0001: has a skew of 0\.5 pixels"):
        list(write_nerfstudio(scene, tmp_path / "a"))
    assert not (tmp_path / "a").exists()
    list(write_posed_folder(scene, tmp_path / "b"))
    again = open_scene(tmp_path / "b").frame(1).intrinsics
    np.testing.assert_allclose(again, skewed.intrinsics, rtol=1e-7)


def test_jpegs_are_good_and_a_second_run_keeps_what_is_there(scene, tmp_path):
    list(write_posed_folder(scene, tmp_path))
    photo = tmp_path / "color" / "0001.jpg"
    error = (np.array(Image.open(photo)).astype(float) - scene.frame(1).image) ** 2
    assert 10 * np.log10(255**2 / error.mean()) > 35
    before = photo.stat().st_mtime_ns
    list(write_posed_folder(scene, tmp_path))
    assert photo.stat().st_mtime_ns == before


def files_in(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*.*"))}


@pytest.mark.parametrize("write", [write_posed_folder, write_nerfstudio])
def test_photos_of_another_scene_are_refused(scene, tmp_path, write):
    list(write(scene, tmp_path))
    before = files_in(tmp_path)
    renamed = [replace(scene.frame(i), name=f"other{i}") for i in range(len(scene))]
    with pytest.raises(InputError, match=r"0000\.jpg: belongs to another scene"):
        list(write(ListedScene("other", renamed), tmp_path))
    assert files_in(tmp_path) == before
    assert len(list(write(scene, tmp_path))) == len(scene)


def test_other_intrinsics_are_refused(scene, tmp_path):
    next(write_posed_folder(scene, tmp_path))
    before = files_in(tmp_path)
    frames = [scene.frame(i) for i in range(len(scene))]
    zoomed = [replace(f, intrinsics=f.intrinsics * [[1.1], [1.1], [1]]) for f in frames]
    for others in (zoomed, [zoomed[0], *frames[1:]]):  # shared, or of each photo
        with pytest.raises(InputError, match=r"intrinsics\.txt: is there with other intrinsics"):
            list(write_posed_folder(ListedScene("room", others), tmp_path))
    assert files_in(tmp_path) == before


@pytest.mark.parametrize(
    "first, second, found",
    [
        (write_posed_folder, write_nerfstudio, "color"),
        (write_nerfstudio, write_posed_folder, r"transforms\.json"),
    ],
)
def test_a_folder_in_the_other_form_is_refused(scene, tmp_path, first, second, found):
    list(first(scene, tmp_path))
    before = files_in(tmp_path)
    with pytest.raises(InputError, match=f"{found}: belongs to a scene in another form"):
        list(second(scene, tmp_path))
    assert files_in(tmp_path) == before


def test_classes_of_an_earlier_conversion_do_not_survive(scene, tmp_path):
    thing = ClassTable(("thing",), ((1, 2, 3),))
    bare = [replace(scene.frame(i), load_labels=None) for i in range(len(scene))]
    for write, folder in [(write_posed_folder, tmp_path / "a"), (write_nerfstudio, tmp_path / "b")]:
        list(write(ListedScene("room", bare, classes=thing), folder))
        assert getattr(open_scene(folder), "classes", None) == thing
        list(write(ListedScene("room", bare), folder))
        assert getattr(open_scene(folder), "classes", None) == SCANNET20


def test_labels_that_would_get_another_meaning_are_refused(scene, tmp_path):
    list(write_posed_folder(scene, tmp_path))
    frames = [scene.frame(i) for i in range(len(scene))]
    other = ListedScene("room", frames, classes=ClassTable(("thing",), ((1, 2, 3),)))
    with pytest.raises(InputError, match="holds labels of other classes than those of room"):
        list(write_posed_folder(other, tmp_path))
    assert not (tmp_path / "classes.json").exists()


def test_a_stopped_nerfstudio_conversion_leaves_no_list_of_other_pictures(scene, tmp_path):
    list(write_nerfstudio(scene, tmp_path))
    next(write_nerfstudio(ScaledScene(scene, 2.0), tmp_path))
    assert not (tmp_path / "transforms.json").exists()


def test_photos_without_poses_are_refused(tmp_path, capsys):
    write_files(tmp_path / "photos")
    shutil.rmtree(tmp_path / "photos/poses")
    for form in ("posed-folder", "nerfstudio"):
        out = str(tmp_path / form)
        assert main(["data", "convert", str(tmp_path / "photos"), "--out", out, "--to", form]) == 2
        assert "photos/0000: is a photo without pose" in capsys.readouterr().err
        assert not list((tmp_path / form).rglob("*.*"))
