"""nerfstudio folders: what is written comes back; what is broken says so."""

import json

import numpy as np
import pytest
from PIL import Image

from mvsam.data.formats import open_scene
from mvsam.data.readers.nerfstudio import open_nerfstudio
from mvsam.errors import InputError
from tests.synthetic import depth_of, labels_of, write_posed_folder


def write_nerfstudio(path, **changes):
    """A synthetic posed folder, told as transforms.json; returns the truth of its frames."""
    truth = write_posed_folder(path / "source", extension="png")
    (path / "source" / "color").rename(path / "images")
    intrinsics = truth[0].intrinsics
    frames = [
        {
            "file_path": f"images/{view.name}.png",
            # OpenGL: y up, z back
            "transform_matrix": (view.world_from_cam @ np.diag([1, -1, -1, 1])).tolist(),
            "depth_file_path": f"source/depth/{view.name}.png",
            "label_file_path": f"source/labels/{view.name}.png",
        }
        for view in truth
    ]
    content = {
        "fl_x": intrinsics[0, 0], "fl_y": intrinsics[1, 1],
        "cx": intrinsics[0, 2], "cy": intrinsics[1, 2],
        "w": 64, "h": 48, "frames": frames,
    } | changes  # fmt: skip
    (path / "transforms.json").write_text(json.dumps(content))
    return truth, content


def test_frames_come_back_in_opencv_axes_with_nothing_added_to_the_principal_point(tmp_path):
    truth, _ = write_nerfstudio(tmp_path)
    scene = open_scene(tmp_path)
    assert len(scene) == len(truth) and scene.views() is None
    for view, index in zip(truth, range(len(scene)), strict=True):
        frame = scene.frame(index)
        assert frame.name == view.name
        np.testing.assert_allclose(frame.world_from_cam, view.world_from_cam, atol=1e-9)
        np.testing.assert_allclose(frame.intrinsics, view.intrinsics)
        np.testing.assert_array_equal(frame.image, view.image)
        np.testing.assert_array_equal(labels_of(frame), view.labels)
        np.testing.assert_allclose(depth_of(frame), view.depth, atol=0.51e-3)


def test_a_calibration_of_larger_pictures_is_scaled(tmp_path):
    truth, content = write_nerfstudio(tmp_path)
    doubled = {key: 2 * content[key] for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
    (tmp_path / "transforms.json").write_text(json.dumps(content | doubled))
    np.testing.assert_allclose(open_scene(tmp_path).frame(0).intrinsics, truth[0].intrinsics)


def test_an_opening_angle_serves_as_focal_length(tmp_path):
    _, content = write_nerfstudio(tmp_path)
    for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
        del content[key]
    content["camera_angle_x"] = 2 * np.arctan(0.5)
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    expected = [[64, 0, 32], [0, 64, 24], [0, 0, 1]]
    np.testing.assert_allclose(open_scene(tmp_path).frame(0).intrinsics, expected)


def test_intrinsics_of_a_frame_overrule_the_shared_ones(tmp_path):
    _, content = write_nerfstudio(tmp_path)
    content["frames"][1] |= {"fl_x": 70.0, "fl_y": 71.0}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    scene = open_scene(tmp_path)
    assert scene.frame(1).intrinsics[0, 0] == 70 and scene.frame(1).intrinsics[1, 1] == 71
    assert scene.frame(0).intrinsics[0, 0] == content["fl_x"]


def test_a_lens_is_taken_away_with_a_message(tmp_path, caplog):
    truth, _ = write_nerfstudio(tmp_path, k1=-0.2, camera_model="OPENCV")
    frame = open_scene(tmp_path).frame(0)
    assert "3 pictures undistorted" in caplog.text
    assert np.abs(frame.image.astype(int) - truth[0].image).mean() > 1
    assert frame.depth is not None and (frame.depth[0, 0] == 0) != (frame.depth[0, 0] > 0)


def test_depth_in_another_unit(tmp_path):
    truth, _ = write_nerfstudio(tmp_path, depth_unit_scale_factor=2e-3)
    depth = open_scene(tmp_path).frame(0).depth
    assert depth is not None
    np.testing.assert_allclose(depth, 2 * truth[0].depth, atol=1.1e-3)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"frames": {}}, "no list of frames"),
        ({"frames": [{}]}, "no 'file_path'"),
        ({"frames": []}, "no frame"),
        ({"camera_model": "EQUIRECTANGULAR"}, "not supported"),
        ({"fl_x": "wide"}, "not a number"),
        ({"fl_x": float("nan")}, "not a number"),
        ({"w": 100, "h": 100}, "another shape"),
        ({"fl_x": -5.0}, "must be positive"),
        ({"depth_unit_scale_factor": -1}, "the depth scale is -1"),
        ({"depth_unit_scale_factor": 0}, "the depth scale is 0"),
    ],
)
def test_a_broken_file_says_what_to_do(tmp_path, change, message):
    write_nerfstudio(tmp_path, **change)
    with pytest.raises(InputError, match=message):
        open_scene(tmp_path)


@pytest.mark.parametrize("path", ["/etc/passwd", "../secret.png", "images/../../secret.png"])
def test_files_outside_the_folder_are_refused(tmp_path, path):
    Image.new("RGB", (64, 48)).save(tmp_path / "secret.png")
    folder = tmp_path / "scene"
    folder.mkdir()
    _, content = write_nerfstudio(folder)
    content["frames"][0]["file_path"] = path
    (folder / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="leaves the folder"):
        open_scene(folder)


def test_frames_without_tracking_are_left_out(tmp_path, caplog):
    _, content = write_nerfstudio(tmp_path)
    content["frames"][1]["transform_matrix"] = np.full((4, 4), np.nan).tolist()
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    scene = open_scene(tmp_path)
    assert [scene.frame(index).name for index in range(len(scene))] == ["0000", "0002"]
    assert "1 of 3 frames have no pose" in caplog.text


def test_poses_of_colmap_have_no_unit(tmp_path):
    _, content = write_nerfstudio(tmp_path)
    assert open_nerfstudio(tmp_path).has_unit
    for number, entry in enumerate(content["frames"]):
        entry["colmap_im_id"] = number
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    assert not open_nerfstudio(tmp_path).has_unit


@pytest.mark.parametrize("text", ["", "{", "[]", '"x"', "\x00", "[" * 100_000])
def test_what_is_no_json_object_is_refused(tmp_path, text):
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(InputError):
        open_scene(tmp_path)


def test_a_transform_that_is_no_matrix_is_refused(tmp_path):
    _, content = write_nerfstudio(tmp_path)
    numbers = (1e200, 10**400)
    matrices = [[[number] * 4] * 3 + [[0, 0, 0, 1]] for number in numbers]
    for wrong in (None, "x", [[1, 2], [3]], [1, 2, 3], *matrices):
        content["frames"][0]["transform_matrix"] = wrong
        (tmp_path / "transforms.json").write_text(json.dumps(content))
        with pytest.raises(InputError):
            open_scene(tmp_path)


@pytest.mark.parametrize("path", [".", "/", "images/..", "x" * 300, "x/" * 5000 + "x"])
@pytest.mark.parametrize("key", ["file_path", "depth_file_path", "label_file_path"])
def test_a_path_that_no_file_can_have_is_refused(tmp_path, key, path):
    _, content = write_nerfstudio(tmp_path)
    for frame in content["frames"]:
        frame[key] = path
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"transforms\.json frame 0: "):
        open_scene(tmp_path)


def write_two_sizes(path, focal: dict, **changes) -> None:
    """Every photo 64x48 but the second, which is 32x24; the calibration says only `focal`."""
    _, content = write_nerfstudio(path)
    for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"):
        del content[key]
    for frame in content["frames"]:
        del frame["depth_file_path"], frame["label_file_path"]
    photo = path / content["frames"][1]["file_path"]
    Image.open(photo).resize((32, 24)).save(photo)
    content["frames"][1] |= changes
    (path / "transforms.json").write_text(json.dumps(content | focal))


def test_a_focal_length_in_pixels_cannot_serve_photos_of_two_sizes(tmp_path):
    write_two_sizes(tmp_path, {"fl_x": 50.0})
    with pytest.raises(InputError, match=r"0000 \(64x48\) and 0001 \(32x24\) differ in size"):
        open_scene(tmp_path)


@pytest.mark.parametrize(
    "focal, changes, expected",
    [
        ({"fl_x": 50.0, "w": 64, "h": 48}, {}, 25),
        ({"fl_x": 50.0}, {"w": 64, "h": 48}, 25),
        ({"fl_x": 50.0}, {"fl_x": 26.0}, 26),
        ({"camera_angle_x": 2 * np.arctan(0.5)}, {}, 32),
    ],
)
def test_photos_of_two_sizes_may_share_what_is_of_a_stated_size(tmp_path, focal, changes, expected):
    write_two_sizes(tmp_path, focal, **changes)
    assert open_scene(tmp_path).frame(1).intrinsics[0, 0] == pytest.approx(expected)
