"""Each fault in a posed folder gets one sentence that names the file and the remedy."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mvsam.data import open_scene
from mvsam.data.readers.posed_folder import PosedFolder
from mvsam.errors import InputError
from tests.synthetic import camera_pose, write_posed_folder


@pytest.fixture
def folder(tmp_path) -> Path:
    write_posed_folder(tmp_path / "room", views=True)
    return tmp_path / "room"


def complaint(folder: Path) -> str:
    """The one sentence that opening the folder ends with."""
    with pytest.raises(InputError) as error:
        PosedFolder(folder)
    sentence = str(error.value)
    assert "\n" not in sentence
    assert ";" in sentence or "expected" in sentence, "a remedy follows the fault"
    return sentence


def assert_says(sentence: str, *parts: str) -> None:
    for part in parts:
        assert part in sentence


def test_a_path_that_does_not_exist(tmp_path):
    with pytest.raises(InputError, match="nowhere: there is no such folder"):
        open_scene(tmp_path / "nowhere")


def test_a_file_instead_of_a_folder(tmp_path):
    (tmp_path / "photo.jpg").write_bytes(b"")
    with pytest.raises(InputError, match=r"photo\.jpg: this is a file"):
        open_scene(tmp_path / "photo.jpg")


def test_a_folder_of_no_known_format_says_what_was_expected(tmp_path):
    with pytest.raises(InputError, match=r"the simplest is a posed folder with color/NAME\.jpg"):
        open_scene(tmp_path)


def test_an_unknown_format_lists_the_known_ones(folder):
    with pytest.raises(InputError, match=r"unknown format 'colmapp'; choose one of .*posed-folder"):
        open_scene(folder, "colmapp")


def test_no_photos(folder):
    for photo in (folder / "color").iterdir():
        photo.unlink()
    assert_says(complaint(folder), "color: no photos found; put")


@pytest.mark.parametrize("name", ["color", "poses"])
def test_a_missing_folder(folder, name):
    (folder / name).rename(folder / "elsewhere")
    assert_says(complaint(folder), f"{name}: this folder is missing")


def test_a_missing_photo_is_named(folder):
    (folder / "color/0001.png").unlink()
    assert_says(complaint(folder), "2 photos but 3 poses, no photo for 0001;")


def test_a_missing_pose_is_named(folder):
    (folder / "poses/0002.txt").unlink()
    assert_says(complaint(folder), "3 photos but 2 poses, no pose for 0002;")


def test_photos_and_poses_of_other_names_are_both_listed(folder):
    for index in range(3):
        (folder / f"poses/{index:04d}.txt").rename(folder / f"poses/pose{index}.txt")
    sentence = complaint(folder)
    assert_says(sentence, "no pose for 0000, 0001, 0002 and no photo for pose0, pose1, pose2;")


def test_a_photo_that_is_no_picture(folder):
    (folder / "color/0001.png").write_bytes(b"hello")
    assert_says(complaint(folder), "color/0001.png: the photo cannot be read", "copy it again")


def test_an_empty_photo_file(folder):
    (folder / "color/0001.png").write_bytes(b"")
    assert_says(complaint(folder), "color/0001.png: the photo cannot be read")


@pytest.mark.parametrize("extension", ["png", "jpg"])
def test_a_truncated_photo_is_noticed_when_it_is_read(tmp_path, extension):
    write_posed_folder(tmp_path, extension=extension)
    photo = tmp_path / f"color/0001.{extension}"
    photo.write_bytes(photo.read_bytes()[: photo.stat().st_size // 2])
    frame = PosedFolder(tmp_path).frame(1)
    with pytest.raises(InputError, match=rf"0001\.{extension}: the photo cannot be read"):
        _ = frame.image


def test_a_photo_that_vanished_after_opening(folder):
    frame = PosedFolder(folder).frame(0)
    (folder / "color/0000.png").unlink()
    with pytest.raises(InputError, match=r"0000\.png: the photo is missing"):
        _ = frame.image


def test_a_photo_with_16_bits(folder):
    Image.fromarray(np.zeros((48, 64), np.uint16)).save(folder / "color/0000.png")
    assert_says(complaint(folder), "color/0000.png: the photo has pixel type I;16", "8-bit")


def test_two_photos_of_one_name(folder):
    Image.new("RGB", (64, 48)).save(folder / "color/0001.jpg")
    assert_says(complaint(folder), "0001.jpg and 0001.png have the same name", "rename")


def test_photos_of_different_sizes_with_one_intrinsics_file(folder):
    Image.new("RGB", (32, 24)).save(folder / "color/0002.png")
    sentence = complaint(folder)
    assert_says(sentence, "photo 0002 is 32x24 but 0000 is 64x48", "intrinsics/NAME.txt")


def test_missing_intrinsics(folder):
    (folder / "intrinsics.txt").unlink()
    assert_says(complaint(folder), "intrinsics.txt: the file is missing")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("50 0 31\n0 50 23\n", "is not 3x3 (it is 2x3)"),
        ("50 0 31 0\n0 50 23 0\n0 0 1 0\n0 0 0 1\n", "is not 3x3 (it is 4x4)"),
        ("50 0 31\n0 50\n0 0 1\n", "is not 3x3 (3 lines of unequal length)"),
        ("", "is not 3x3 (the file is empty)"),
        ("fx 0 31\n0 50 23\n0 0 1\n", "cannot be read"),
        ("-50 0 31\n0 50 23\n0 0 1\n", "must be positive, not -50 and 50"),
        ("50 0 31\n0 0 23\n0 0 1\n", "must be positive, not 50 and 0"),
        ("nan 0 31\n0 50 23\n0 0 1\n", "are not finite"),
        ("50 0 31\n0 50 inf\n0 0 1\n", "are not finite"),
        ("0.0035 0 31\n0 0.0035 23\n0 0 1\n", "are no camera's for 64x48 photos"),
        ("1e200 0 31\n0 1e200 23\n0 0 1\n", "are no camera's for"),
        ("50 0 0\n0 50 0\n31 23 1\n", "look transposed"),
        ("50 0 31\n0 50 23\n0 0 2\n", "not of the form"),
        ("50 0 640\n0 50 23\n0 0 1\n", "principal point (640, 23) is outside the 64x48 photo"),
    ],
)
def test_bad_intrinsics(folder, content, reason):
    (folder / "intrinsics.txt").write_text(content)
    assert_says(complaint(folder), "intrinsics.txt: ", reason)


def test_bad_intrinsics_of_one_photo_name_its_file(folder):
    (folder / "intrinsics").mkdir()
    for index in range(3):
        focal = -50 if index == 1 else 50
        (folder / f"intrinsics/{index:04d}.txt").write_text(f"{focal} 0 31\n0 50 23\n0 0 1\n")
    assert_says(complaint(folder), "intrinsics/0001.txt: the focal lengths must be positive")
    (folder / "intrinsics/0001.txt").unlink()
    assert_says(complaint(folder), "intrinsics/0001.txt: the file is missing")


def numbers(matrix: np.ndarray) -> str:
    return "\n".join(" ".join(f"{value:.8f}" for value in row) for row in matrix)


POSE = camera_pose(1)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (numbers(POSE[:3]), "is not 4x4 (it is 3x4)"),
        ("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1", "is not 4x4 (it is 1x16)"),
        ("\x00\x01", "cannot be read"),
        (numbers(POSE).replace("0.", "-inf ", 1), "is not 4x4"),
        (numbers(POSE.T), "it looks transposed"),
        (numbers(POSE + np.diag([0, 0, 0, 1.0])), "last row is not 0 0 0 1"),
        (numbers(POSE @ np.diag([2, 2, 2, 1.0])), "not rigid, it is scaled by 2;"),
        (numbers(POSE @ np.diag([1, 1, 3, 1.0])), "not rigid; the upper left"),
        (numbers(POSE @ np.diag([1, 1, 0, 1.0])), "not rigid; the upper left"),
        (numbers(POSE @ np.diag([1, 1, 1e200, 1.0])), "not rigid, its upper left 3x3 holds 9"),
        (numbers(POSE @ np.diag([1, -1, 1, 1.0])), "mirrors the world"),
        (numbers(POSE + np.eye(4, k=3) * 5e5), "500000 m from the origin"),
    ],
)
def test_a_bad_pose(folder, content, reason):
    (folder / "poses/0001.txt").write_text(content)
    assert_says(complaint(folder), "poses/0001.txt: ", reason)


@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_photos_whose_tracking_was_lost_are_left_out(folder, value, caplog):
    """And so are they in the view tuples."""
    (folder / "poses/0001.txt").write_text(numbers(np.full((4, 4), value)))
    (folder / "views.txt").write_text("0000 0001 0002\n0001 0000\n0002 0001\n")
    scene = PosedFolder(folder)
    assert [scene.frame(index).name for index in range(len(scene))] == ["0000", "0002"]
    assert scene.views() == [(0, 1)] and scene.num_lost == 1
    assert "1 of 3 frames have no pose" in caplog.text


def test_a_folder_without_any_pose(folder):
    for file in (folder / "poses").iterdir():
        file.write_text(numbers(np.full((4, 4), np.nan)))
    assert_says(complaint(folder), "none of its 3 pictures has a pose")


def test_a_pose_rounded_to_four_digits_is_rigid_enough(folder):
    text = "\n".join(" ".join(f"{value:.4f}" for value in row) for row in POSE)
    (folder / "poses/0001.txt").write_text(text)
    assert len(PosedFolder(folder)) == 3


def test_a_depth_map_of_another_size(folder):
    Image.fromarray(np.zeros((24, 32), np.uint16)).save(folder / "depth/0001.png")
    sentence = complaint(folder)
    assert_says(sentence, "depth/0001.png: the depth map is 32x24 but its photo is 64x48;")


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_a_depth_map_of_another_type(folder, mode):
    Image.new(mode, (64, 48)).save(folder / "depth/0001.png")
    assert_says(complaint(folder), f"has pixel type {mode}, expected a 16-bit greyscale PNG")


def test_a_truncated_depth_map(folder):
    file = folder / "depth/0001.png"
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(InputError, match=r"depth/0001\.png: the depth map cannot be read"):
        _ = PosedFolder(folder).frame(1).depth


def test_a_depth_map_without_photo(folder):
    Image.fromarray(np.zeros((48, 64), np.uint16)).save(folder / "depth/0009.png")
    assert_says(complaint(folder), "depth/0009.png: no photo color/0009.jpg or .png belongs")


def test_a_label_map_of_another_size(folder):
    Image.new("L", (32, 24)).save(folder / "labels/0001.png")
    assert_says(complaint(folder), "labels/0001.png: the label map is 32x24")


def test_a_label_map_of_another_type(folder):
    Image.new("RGB", (64, 48)).save(folder / "labels/0001.png")
    assert_says(complaint(folder), "labels/0001.png: the label map has pixel type RGB")


def test_a_label_beyond_the_classes(folder):
    Image.fromarray(np.full((48, 64), 40, np.uint8)).save(folder / "labels/0001.png")
    with pytest.raises(InputError, match=r"0001\.png: label 40 is neither 0\.\.19 nor 255"):
        _ = PosedFolder(folder).frame(1).labels


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("0000 0001\n0001 0007\n", "views.txt line 2: there is no photo named 0007"),
        ("0000.png 0001\n", "views.txt line 1: there is no photo named 0000.png"),
        ("# one\n0000\n", "views.txt line 2: a reference needs at least one source"),
        ("0000 0001 0000\n", "views.txt line 1: a photo occurs twice"),
        ("# nothing\n\n", "views.txt: holds no view tuple"),
    ],
)
def test_malformed_views(folder, content, reason):
    (folder / "views.txt").write_text(content)
    assert_says(complaint(folder), reason)


def test_views_that_are_not_text(folder):
    (folder / "views.txt").write_bytes(b"\xff\xfe\x00\xd8")
    assert_says(complaint(folder), "views.txt: cannot be read")


def test_a_rotation_beside_the_pixels_is_said_to_be_left_out_once(folder: Path, caplog):
    notes = Image.Exif()
    notes[0x0112] = 6  # stored on its side
    for photo in list((folder / "color").iterdir()):
        with Image.open(photo) as picture:
            picture.convert("RGB").save(photo.with_suffix(".jpg"), exif=notes)
        if photo.suffix != ".jpg":
            photo.unlink()
    scene = PosedFolder(folder)
    assert len(scene) > 1
    assert caplog.text.count("EXIF rotation, which is not applied") == 1
