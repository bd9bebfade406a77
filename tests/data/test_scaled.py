"""A scene's unit from a measured distance: `--scale A:B=METRES`."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mvsam.cli import main
from mvsam.data.catalog import open_data
from mvsam.data.formats import FORMATS, open_scene
from mvsam.data.scaled import parse_scale
from mvsam.errors import InputError
from mvsam.types import Frame
from tests.data.readers.layouts import FREE, LAYOUTS, write_posed
from tests.synthetic import synthetic_views, write_posed_folder

UNIT = 0.25
"""Metres; the scenes here are written in it."""


def frames_in_unit(unit: float = UNIT) -> list[Frame]:
    views = synthetic_views(3)
    for view in views:
        view.world_from_cam[:3, 3] /= unit
    return [
        Frame(
            v.name, (64, 48), v.intrinsics, v.world_from_cam,
            lambda v=v: v.image, lambda v=v: v.depth, lambda v=v: v.labels,
        )
        for v in views
    ]  # fmt: skip


def distance(first: int, second: int) -> float:
    """Metres between two of the cameras."""
    a, b = (synthetic_views(3)[index].world_from_cam[:3, 3] for index in (first, second))
    return float(np.linalg.norm(a - b))


@pytest.fixture
def room(tmp_path: Path) -> str:
    write_posed(frames_in_unit(), tmp_path / "room")
    return str(tmp_path / "room")


@pytest.mark.parametrize("name", [name for name in FORMATS if LAYOUTS[name].size == FREE])
def test_the_distance_of_two_photos_tells_the_unit_in_every_format(tmp_path, name, caplog):
    folder = tmp_path / "42"
    LAYOUTS[name].write(frames_in_unit(), folder)
    if name == "colmap":  # where there is measured depth, that tells the scale
        for file in (folder / "depth").iterdir():
            file.unlink()
    names = [open_scene(folder).frame(index).name for index in (0, 2)]
    scene = open_scene(folder, scale=f"{names[0]}:{names[1]}={distance(0, 2)}")
    assert "one unit of the poses is 0.25" in caplog.text
    centres = [scene.frame(index).world_from_cam[:3, 3] for index in range(3)]
    measured = [np.linalg.norm(centre - centres[0]) for centre in centres]
    # Some formats keep six digits of a pose.
    np.testing.assert_allclose(measured, [0, distance(0, 1), distance(0, 2)], atol=1e-4)


@pytest.mark.parametrize("ending", ["", ".png", ".JPG"])
def test_photos_are_named_with_or_without_their_ending(room, ending):
    given = f"0000{ending}:0001{ending}={distance(0, 1)}"
    pose = open_scene(room, scale=given).frame(1).world_from_cam
    np.testing.assert_allclose(pose, synthetic_views(3)[1].world_from_cam, atol=1e-6)


def test_photos_of_a_colmap_model_may_lie_in_folders(tmp_path):
    pytest.importorskip("pycolmap")
    LAYOUTS["colmap"].write(frames_in_unit(), tmp_path)
    for file in (tmp_path / "depth").iterdir():
        file.unlink()
    listed = tmp_path / "sparse/0/images.txt"
    listed.write_text(listed.read_text().replace(" 0000.png", " left/0000.png"))
    (tmp_path / "images/left").mkdir()
    (tmp_path / "images/0000.png").rename(tmp_path / "images/left/0000.png")
    scene = open_scene(tmp_path, scale=f"left/0000.png:0001.png={distance(0, 1)}")
    at = {scene.frame(i).name: scene.frame(i).world_from_cam[:3, 3] for i in range(3)}
    np.testing.assert_allclose(np.linalg.norm(at["left_0000"] - at["0001"]), distance(0, 1))


def test_the_cameras_that_colmap_found_are_scaled_too(tmp_path):
    pytest.importorskip("pycolmap")
    LAYOUTS["colmap"].write(frames_in_unit(), tmp_path)
    for file in (tmp_path / "depth").iterdir():
        file.unlink()
    (scene,) = open_data(str(tmp_path), scale=f"0000:0002={distance(0, 2)}", poses="colmap")
    pose = scene.frame(1).world_from_cam
    np.testing.assert_allclose(pose, synthetic_views(3)[1].world_from_cam, atol=1e-6)


@pytest.mark.parametrize(
    "scale, message",
    [
        ("long", "give metres a unit, as 0.31, or two photos"),
        ("0000:0001", "give metres a unit, as 0.31, or two photos"),
        (":0001=2", "give metres a unit, as 0.31, or two photos"),
        ("0000:0001=", "'' is no distance in metres"),
        ("0000:0001=far", "'far' is no distance in metres"),
        ("0000:0001=nan", "'nan' is no distance in metres"),
        ("0000:0001=inf", "'inf' is no distance in metres"),
        ("0000:0001=0", "'0' is no distance in metres"),
        ("0000:0001=-1", "'-1' is no distance in metres"),
        ("0000:0000.png=1", "0000 and 0000.png are one photo"),
        ("0000:0009=1", "room has no photo named 0009; it has 000"),
        ("0000:IMG_7.jpg=1", r"no photo named IMG_7\.jpg; it has 0000, \.\.\., 0002\."),
    ],
)
def test_a_scale_that_says_nothing_is_refused(room, scale, message):
    with pytest.raises(InputError, match=message):
        open_scene(room, scale=scale)


def test_a_bad_scale_is_refused_before_colmap_takes_minutes(tmp_path):
    Image.new("RGB", (8, 8)).save(tmp_path / "0.png")
    with pytest.raises(InputError, match="no distance in metres"):
        open_scene(tmp_path, scale="0:1=x", poses="colmap")


def test_cameras_at_one_place_tell_no_scale(tmp_path):
    frames = frames_in_unit()
    frames[1].world_from_cam[:3, 3] = frames[0].world_from_cam[:3, 3]
    write_posed(frames, tmp_path / "room")
    with pytest.raises(InputError, match="0000 and 0001 stand at one place"):
        open_scene(tmp_path / "room", scale="0000:0001=1")


def test_measured_depth_and_a_measured_distance_are_one_too_many(tmp_path):
    pytest.importorskip("pycolmap")
    from tests.data.readers.test_colmap import with_points

    with_points(tmp_path, unit=UNIT)
    with pytest.raises(InputError, match="leave --scale out"):
        open_scene(tmp_path, scale="0000:0001=0.1")


def test_a_distance_is_that_of_one_scene(tmp_path):
    for name in "ab":
        write_posed_folder(tmp_path / name)
    (tmp_path / "both.txt").write_text("a\nb\n")
    for data in (tmp_path, tmp_path / "both.txt"):
        with pytest.raises(InputError, match="holds 2 scenes"):
            open_data(str(data), scale="0000:0001=0.1")
        assert len(open_data(str(data), scale="2")) == 2


def test_what_has_its_unit_or_no_poses_takes_no_scale(tmp_path):
    with pytest.raises(InputError, match="rooms are in metres"):
        open_data("rooms:val:0-1", scale=2.0)
    write_posed_folder(tmp_path / "singles")
    for pose in (tmp_path / "singles/poses").iterdir():
        pose.unlink()
    (tmp_path / "singles/poses").rmdir()
    with pytest.raises(InputError, match="photos without poses"):
        open_data(str(tmp_path / "singles"), scale="0000:0001=0.1")


def test_a_number_is_a_number_of_metres_a_unit():
    assert parse_scale("0.31") == parse_scale(0.31) == 0.31


@pytest.mark.parametrize("verb", [("predict",), ("eval",), ("data", "check"), ("data", "convert")])
def test_every_command_with_a_scale_explains_both_forms(verb, capsys):
    assert main([*verb, "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "--scale METRES|A:B=METRES" in text and "0001.jpg:0007.jpg=0.25" in text


def test_convert_writes_metres_and_says_how_long_a_unit_is(room, tmp_path, capsys):
    out = str(tmp_path / "out")
    given = f"0000.png:0002.png={distance(0, 2):.9f}"
    assert main(["data", "convert", room, "--out", out, "--scale", given]) == 0
    assert "one unit of the poses is 0.25 m" in capsys.readouterr().err
    pose = open_scene(out).frame(2).world_from_cam
    np.testing.assert_allclose(pose, synthetic_views(3)[2].world_from_cam, atol=1e-6)


def test_check_reports_baselines_in_metres(room, capsys):
    given = f"0000:0001={distance(0, 1):.9f}"
    assert main(["data", "check", room, "--json", "--scale", given]) == 0
    (report,) = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(report["baselines"][1], distance(0, 1), rtol=0.01)


def test_the_command_line_names_photos_that_are_close(room, tmp_path, capsys):
    arguments = ["data", "convert", room, "--out", str(tmp_path / "out")]
    assert main([*arguments, "--scale", "0000.png:001.png=0.25"]) == 2
    assert "room has no photo named 001.png; it has 000" in capsys.readouterr().err
