"""ScanNet, raw and exported, written here to the published layout."""

import tracemalloc
import zipfile

import numpy as np
import pytest
from PIL import Image

from mvsam.cli import main
from mvsam.data.catalog import open_data
from mvsam.data.formats import open_scene
from mvsam.data.nyu40 import from_nyu40
from mvsam.data.readers import label_zip
from mvsam.data.readers.sens import SensFile
from mvsam.data.scannet_export import export, plan
from mvsam.errors import InputError
from mvsam.types import IGNORE
from tests.data.readers.sens_writer import write_label_zip, write_sens, write_tsv
from tests.synthetic import depth_of, labels_of, write_posed_folder

CENTRES = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
RAW = np.array([[1, 2, 3], [99, 0, 5000]])
CLASSES = [[0, 4, 1], [IGNORE, IGNORE, IGNORE]]


def write_raw(path, lost: int | None = None):
    """Colour 64x48; depth of every second pixel, 32x24. Returns the truth of the frames."""
    truth = write_posed_folder(path.parent / "truth", extension="png")
    path.mkdir()
    matrix = truth[0].intrinsics
    half = matrix * [[0.5], [0.5], [1]]
    poses = [view.world_from_cam.copy() for view in truth]
    if lost is not None:
        poses[lost][:] = -np.inf
    write_sens(
        path / "scene0000_00.sens",
        [view.image for view in truth],
        [view.depth[1::2, 1::2] for view in truth],
        poses,
        matrix - CENTRES,
        half - CENTRES,
    )
    ids = np.kron(RAW, np.ones((24, 22), int))[:, :64]
    write_label_zip(path / "scene0000_00_2d-label-filt.zip", [ids] * len(truth))
    write_tsv(path.parent / "scannetv2-labels.combined.tsv")
    return truth


def test_a_raw_scan_comes_back(tmp_path):
    truth = write_raw(tmp_path / "scan")
    scene = open_scene(tmp_path / "scan")
    assert scene.name == "scan" and len(scene) == len(truth)
    for index, view in enumerate(truth):
        frame = scene.frame(index)
        np.testing.assert_allclose(frame.world_from_cam, view.world_from_cam, atol=1e-6)
        np.testing.assert_allclose(frame.intrinsics, view.intrinsics, atol=1e-4)
        error = (frame.image.astype(float) - view.image) ** 2
        assert 10 * np.log10(255**2 / error.mean()) > 38
        expected = np.kron(view.depth[1::2, 1::2], np.ones((2, 2)))
        np.testing.assert_allclose(depth_of(frame), expected, atol=0.51e-3)
        labels = labels_of(frame)
        assert [labels[5, 5], labels[5, 30], labels[5, 60]] == CLASSES[0]
        assert (labels[30:] == IGNORE).all()


def test_two_scans_whose_files_have_one_name_stay_two_scenes(tmp_path):
    for name in "ab":
        write_raw(tmp_path / name)
    (tmp_path / "both.txt").write_text("a b")
    scans, out = str(tmp_path / "both.txt"), tmp_path / "out"
    assert [scene.name for scene in open_data(scans)] == ["a", "b"]
    assert main(["data", "convert", scans, "--out", str(out)]) == 0
    assert sorted(path.name for path in out.iterdir()) == ["a", "b"]


def test_frames_without_tracking_are_left_out_and_keep_their_numbers(tmp_path, caplog):
    write_raw(tmp_path / "scan", lost=1)
    scene = open_scene(tmp_path / "scan")
    assert [scene.frame(i).name for i in range(len(scene))] == ["000000", "000002"]
    assert "1 of 3 frames have no pose" in caplog.text


def test_a_missing_category_table_is_noticed_at_once(tmp_path):
    write_raw(tmp_path / "scan")
    (tmp_path / "scannetv2-labels.combined.tsv").unlink()
    with pytest.raises(InputError, match=r"comes with ScanNet's download"):
        open_scene(tmp_path / "scan")


def test_every_cut_and_many_wrong_bytes_are_refused_or_read(tmp_path):
    """Whatever the bytes say, only our own error comes out."""
    write_raw(tmp_path / "scan")
    file = tmp_path / "scan" / "scene0000_00.sens"
    whole = file.read_bytes()
    dice = np.random.default_rng(0)
    cuts = [0, 3, 4, 12, 20, 200, 300, 330, 400, len(whole) - 1]
    variants = [whole[:cut] for cut in cuts]
    for _ in range(120):
        broken = bytearray(whole)
        for _ in range(3):
            place = dice.integers(0, 420 if dice.random() < 0.7 else len(whole))
            broken[place] = dice.integers(0, 256)
        variants.append(bytes(broken))
    refused = 0
    for variant in variants:
        file.write_bytes(variant)
        try:
            scan = SensFile(file)
            for index in range(len(scan.frames)):
                scan.color(index)
                scan.depth(index)
        except InputError:
            refused += 1
    assert refused > 40


@pytest.mark.parametrize(
    "place, value, message",
    [
        (0, 5, "version"),
        (4, 2**40, "name is longer"),
        (283, 7, "not supported"),
        (291, 10**6, "1000000x48"),
        (299, 16384 * (2**32 + 1), "and 16384x16384 pixels"),
        (307, 0, "the depth scale is 0"),
        (311, 2**50, "too short"),
    ],
)
def test_a_header_that_cannot_be_is_refused_before_memory_is_taken(tmp_path, place, value, message):
    write_raw(tmp_path / "scan")
    file = tmp_path / "scan" / "scene0000_00.sens"
    content = bytearray(file.read_bytes())
    size = 8 if place in (4, 299, 311) else 4
    content[place : place + size] = value.to_bytes(size, "little")
    file.write_bytes(content)
    with pytest.raises(InputError, match=message):
        SensFile(file)


def test_depth_that_its_bytes_cannot_hold_is_refused_before_memory_is_taken(tmp_path):
    write_raw(tmp_path / "scan")
    file = tmp_path / "scan" / "scene0000_00.sens"
    content = bytearray(file.read_bytes())
    content[299:307] = (4096).to_bytes(4, "little") * 2
    file.write_bytes(content)
    tracemalloc.start()
    with pytest.raises(InputError, match="too short for 4096x4096 pixels"):
        SensFile(file).depth(0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**20


def write_exported(path, label_type=np.uint16):
    truth = write_posed_folder(path.parent / "truth", extension="png")
    for folder in ("color", "depth", "pose", "intrinsic", "label-filt"):
        (path / folder).mkdir(parents=True)
    matrix = np.eye(4)
    matrix[:3, :3] = truth[0].intrinsics - CENTRES
    np.savetxt(path / "intrinsic/intrinsic_color.txt", matrix)
    np.savetxt(path / "intrinsic/intrinsic_depth.txt", matrix)
    for index, view in enumerate(truth):
        Image.fromarray(view.image).save(path / f"color/{index}.jpg", quality=98, subsampling=0)
        pixels = np.rint(view.depth * 1000).astype(np.uint16)
        Image.fromarray(pixels).save(path / f"depth/{index}.png")
        np.savetxt(path / f"pose/{index}.txt", view.world_from_cam)
        ids = np.full((48, 64), 5 if label_type == np.uint8 else 2, label_type)
        Image.fromarray(ids).save(path / f"label-filt/{index}.png")
    write_tsv(path.parent / "scannetv2-labels.combined.tsv")
    return truth


@pytest.mark.parametrize("label_type", [np.uint8, np.uint16], ids=["nyu40", "raw"])
def test_an_exported_scan_comes_back(tmp_path, label_type):
    truth = write_exported(tmp_path / "scene0001_00", label_type)
    scene = open_scene(tmp_path / "scene0001_00")
    for index, view in enumerate(truth):
        frame = scene.frame(index)
        np.testing.assert_allclose(frame.world_from_cam, view.world_from_cam, atol=1e-7)
        np.testing.assert_allclose(frame.intrinsics, view.intrinsics, atol=1e-9)
        np.testing.assert_allclose(depth_of(frame), view.depth, atol=0.51e-3)
        assert (labels_of(frame) == 4).all(), "a chair"


@pytest.mark.parametrize("label_type", [np.uint8, np.uint16], ids=["nyu40", "raw"])
def test_an_export_needs_the_category_table_for_raw_ids_alone(tmp_path, label_type):
    write_exported(tmp_path / "a/b/scan", label_type)
    table = tmp_path / "a/b/scannetv2-labels.combined.tsv"
    table = table.rename(tmp_path / table.name)
    assert (labels_of(open_scene(tmp_path / "a/b/scan").frame(0)) == 4).all()
    table.unlink()
    if label_type == np.uint8:
        assert (labels_of(open_scene(tmp_path / "a/b/scan").frame(0)) == 4).all()
        return
    with pytest.raises(InputError, match=r"download-scannet\.py --label_map"):
        open_scene(tmp_path / "a/b/scan")


def test_a_label_picture_of_absurd_size_is_not_unpacked(tmp_path, monkeypatch):
    write_raw(tmp_path / "scan")
    monkeypatch.setattr(label_zip, "LARGEST_PICTURE", 2**20)
    file = tmp_path / "scan/scene0000_00_2d-label-filt.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("label-filt/0.png", bytes(50 * 2**20))
    tracemalloc.start()
    with pytest.raises(InputError, match="has more than 1 MB"):
        label_zip.read_label(file, "label-filt/0.png")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * 2**20
    with pytest.raises(InputError, match="has more than 1 MB"):
        labels_of(open_scene(tmp_path / "scan").frame(0))
    with pytest.raises(InputError, match="has more than 1 MB"):
        list(export(plan(tmp_path / "scan", tmp_path / "out")[0], 1))


def test_a_photo_without_pose_is_named(tmp_path):
    write_exported(tmp_path / "scan")
    (tmp_path / "scan/pose/1.txt").unlink()
    with pytest.raises(InputError, match=r"1\.jpg: has no pose"):
        open_scene(tmp_path / "scan")


def test_the_twenty_classes_in_benchmark_order():
    ids = np.array([[0, 1, 2, 5, 12, 13, 14], [16, 24, 28, 33, 34, 36, 39]])
    expected = [[IGNORE, 0, 1, 4, 11, IGNORE, 12], [13, 14, 15, 16, 17, 18, 19]]
    np.testing.assert_array_equal(from_nyu40(ids), expected)


def test_a_zipped_label_picture_of_an_absurd_number_is_refused(tmp_path):
    write_raw(tmp_path / "scan")
    file = tmp_path / "scan/scene0000_00_2d-label-filt.zip"
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr(f"label-filt/{'9' * 5000}.png", b"")
    with pytest.raises(InputError, match=r"label-filt\.zip: cannot be read"):
        open_scene(tmp_path / "scan")
