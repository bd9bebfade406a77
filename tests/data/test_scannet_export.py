"""`mvsam data scannet`: what is exported is what the scan holds, once."""

import re
import shutil

import numpy as np
import pytest
from PIL import Image

from mvsam.cli import main
from mvsam.data.formats import open_scene
from mvsam.data.nyu40 import TSV
from mvsam.data.scannet_export import copy_table, export, find_scans, plan
from mvsam.errors import InputError
from tests.data.readers.test_scannet import write_raw
from tests.synthetic import depth_of, labels_of


@pytest.fixture
def scan(tmp_path):
    write_raw(tmp_path / "scans/scene0000_00", lost=1)
    return tmp_path / "scans/scene0000_00"


def test_an_export_reads_as_the_scan_itself(scan, tmp_path):
    assert (
        main(["data", "scannet", str(scan), "--out", str(tmp_path / "out"), "--workers", "1"]) == 0
    )
    before, after = open_scene(scan), open_scene(tmp_path / "out/scene0000_00")
    assert len(after) == len(before) == 2
    assert [getattr(scene, "num_lost", 0) for scene in (before, after)] == [1, 1]
    for index in range(2):
        first, second = before.frame(index), after.frame(index)
        assert int(first.name) == int(second.name)
        np.testing.assert_array_equal(second.image, first.image)
        np.testing.assert_array_equal(depth_of(second), depth_of(first))
        np.testing.assert_array_equal(labels_of(second), labels_of(first))
        np.testing.assert_allclose(second.world_from_cam, first.world_from_cam, atol=1e-6)
        np.testing.assert_allclose(second.intrinsics, first.intrinsics, rtol=1e-6)


def test_a_stopped_export_goes_on_and_keeps_what_is_whole(scan, tmp_path):
    out = tmp_path / "out"
    jobs, done = plan(scan, out)
    assert (done, [job.frames for job in jobs]) == (0, [(0, 1, 2)])
    assert sum(export(jobs, 1)) == 3
    (out / "pose/2.txt").unlink()
    (out / "color/0.jpg").write_bytes(b"mine")
    jobs, done = plan(scan, out)
    assert (done, [job.frames for job in jobs]) == (2, [(2,)])
    list(export(jobs, 1))
    assert (out / "color/0.jpg").read_bytes() == b"mine"
    assert plan(scan, out) == ([], 3)


def test_several_processes_write_the_same_files(scan, tmp_path):
    for workers in (1, 2):
        list(export(plan(scan, tmp_path / str(workers))[0], workers))
    files = sorted(p.relative_to(tmp_path / "1") for p in (tmp_path / "1").rglob("*.*"))
    assert len(files) == 2 + 3 + 2 * 3
    for file in files:
        assert (tmp_path / "1" / file).read_bytes() == (tmp_path / "2" / file).read_bytes()


def test_every_second_frame_at_another_size(scan, tmp_path):
    list(export(plan(scan, tmp_path / "out", every=2, size=(32, 24))[0], 1))
    copy_table([scan], tmp_path)
    scene = open_scene(tmp_path / "out")
    truth = open_scene(scan)
    assert [scene.frame(i).name for i in range(len(scene))] == ["0", "2"]
    np.testing.assert_allclose(
        scene.frame(0).intrinsics[:2], truth.frame(0).intrinsics[:2] / 2, rtol=1e-5
    )
    small = np.asarray(Image.fromarray(truth.frame(0).image).reduce(2), dtype=float)
    red, other = (scene.frame(i).image[..., 0].ravel() for i in range(2))
    likeness = [np.corrcoef(small[..., 0].ravel(), photo)[0, 1] for photo in (red, other)]
    assert likeness[0] > 0.7 > 2 * likeness[1], "JPEG blurs a texture as fine as these 32 pixels"
    assert depth_of(scene.frame(0)).shape == (24, 32)


def test_a_folder_begun_at_another_size_is_refused(scan, tmp_path):
    list(export(plan(scan, tmp_path / "out", every=2, size=(32, 24))[0], 1))
    plan(scan, tmp_path / "out", size=(32, 24))
    with pytest.raises(InputError, match="another --size"):
        plan(scan, tmp_path / "out")


def export_all(scans, out, *options: str) -> int:
    return main(["data", "scannet", str(scans), "--out", str(out), "--workers", "1", *options])


def test_labels_that_come_later_are_exported_alone(scan, tmp_path):
    archive, away = scan / "scene0000_00_2d-label-filt.zip", tmp_path / "away.zip"
    archive.rename(away)
    out = tmp_path / "out/scene0000_00"
    assert export_all(scan, tmp_path / "out") == 0
    assert open_scene(out).frame(0).labels is None
    (out / "color/0.jpg").write_bytes(before := (out / "color/2.jpg").read_bytes())
    away.rename(archive)
    assert export_all(scan, tmp_path / "out") == 0
    for exported, index in ((open_scene(out).frame(i), i) for i in range(2)):
        truth = labels_of(open_scene(scan).frame(index))
        np.testing.assert_array_equal(labels_of(exported), truth)
    assert (out / "color/0.jpg").read_bytes() == before, "photos are not written again"
    assert plan(scan, out) == ([], 3)


def test_labels_that_are_not_filtered_are_exported_too(scan, tmp_path):
    archive = scan / "scene0000_00_2d-label-filt.zip"
    archive.rename(scan / "scene0000_00_2d-label.zip")
    assert export_all(scan, tmp_path / "out") == 0
    assert (tmp_path / "out" / TSV).exists()
    out = tmp_path / "out/scene0000_00"
    truth = labels_of(open_scene(scan).frame(1))
    np.testing.assert_array_equal(labels_of(open_scene(out).frame(1)), truth)
    assert sorted(file.name for file in (out / "label").iterdir()) == ["0.png", "2.png"]


def test_the_folder_we_stand_in_has_a_name(scan, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(scan)
    assert export_all(".", tmp_path / "out") == 0
    assert open_scene(tmp_path / "out/scene0000_00").name == "scene0000_00"
    assert "scene0000_00" in capsys.readouterr().err


def test_scans_that_a_file_of_tuples_does_not_name_are_left_out(scan, tmp_path, capsys):
    shutil.copytree(scan, scan.parent / "scene0000_01")
    (tmp_path / "mine.txt").write_text("scene0000_01 0 2\n")
    options = ["--tuples", str(tmp_path / "mine.txt"), "--views", "2"]
    assert export_all(scan.parent, tmp_path / "out", *options) == 0
    assert "1 scan in" in capsys.readouterr().out
    assert not (tmp_path / "out/scene0000_00").exists()
    assert open_scene(tmp_path / "out/scene0000_01").views() == [(0, 1)]


@pytest.mark.parametrize(
    "options, sentence",
    [
        (["--tuples", "often"], "unknown rule of view tuples 'often'"),
        (["--tuples", "nowhere.txt"], "there is no such file"),
        (["--tuples", "other.txt"], r"names none of these scans \(scene0000_00"),
        (["--size", "0", "0"], "--size 0 0 is no size"),
        (["--size", "-64", "48"], "--size -64 48 is no size"),
    ],
)
def test_options_that_cannot_be_are_refused_before_anything_is_written(
    scan, tmp_path, monkeypatch, capsys, options, sentence
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.txt").write_text("scene0999_00 0 1 2\n")
    assert export_all(scan, tmp_path / "out", *options) == 2
    assert re.search(sentence, capsys.readouterr().err)
    assert not (tmp_path / "out").exists()


def test_tuples_of_a_rule_are_written_and_read_again(scan, tmp_path):
    arguments = ["data", "scannet", str(scan.parent), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--tuples", "keyframes", "--views", "2", "--workers", "1"]) == 0
    assert open_scene(tmp_path / "out/scene0000_00").views() == [(0, 1), (1, 0)]


def test_scans_are_found_alone_together_and_by_list(scan, tmp_path):
    assert find_scans(scan) == [scan]
    assert find_scans(scan.parent) == [scan]
    (tmp_path / "scannetv2_val.txt").write_text("scene0000_00")
    assert find_scans(tmp_path / "scannetv2_val.txt") == [scan]
    with pytest.raises(InputError, match=r"no \.sens in it"):
        find_scans(tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        find_scans(tmp_path / "nowhere")


def test_the_table_goes_along_if_any_scan_has_labels(scan, tmp_path):
    bare = scan.parent / "scene0000"  # comes first
    bare.mkdir()
    (bare / "scene0000.sens").write_bytes((scan / "scene0000_00.sens").read_bytes())
    out = tmp_path / "out"
    assert main(["data", "scannet", str(scan.parent), "--out", str(out), "--workers", "1"]) == 0
    assert (out / TSV).read_bytes() == (scan.parent / TSV).read_bytes()
    assert open_scene(out / "scene0000").frame(0).labels is None
    assert open_scene(out / "scene0000_00").frame(0).labels is not None


def test_two_scans_in_one_folder_are_refused(scan, tmp_path):
    (scan / "copy.sens").write_bytes((scan / "scene0000_00.sens").read_bytes())
    with pytest.raises(InputError, match=r"holds 2 \.sens files"):
        plan(scan, tmp_path / "out")
