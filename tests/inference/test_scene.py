import errno
import json
import logging
import os
from copy import deepcopy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import Image

import mvsam.files
from mvsam.data.formats import open_scene
from mvsam.data.labels import png_palette
from mvsam.encoders.fpn import FeaturePyramid
from mvsam.errors import InputError
from mvsam.files import DiskFullError
from mvsam.inference.photos import check_size
from mvsam.inference.pictures import LEGEND_HEIGHT
from mvsam.inference.record import hash_of_values
from mvsam.inference.scene import predict_scene
from tests.inference.fake_model import FakeModel, WholeModel
from tests.synthetic import SyntheticView, write_posed_folder

SIZE = (128, 96)


@pytest.fixture
def truth(tmp_path: Path) -> list[SyntheticView]:
    return write_posed_folder(tmp_path / "room", 4, SIZE)


@pytest.fixture
def scene(tmp_path: Path, truth: list[SyntheticView]):
    return open_scene(tmp_path / "room")


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"


def read(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        return np.array(picture)


def files_of(out: Path) -> dict[str, int]:
    """Each file below `out` and when it was last changed."""
    paths = [path for path in out.rglob("*") if path.is_file()]
    return {str(path.relative_to(out)): path.stat().st_mtime_ns for path in paths}


def test_every_promised_file_is_written(scene, out: Path):
    result = predict_scene(FakeModel(), scene, out, save_npz=True)
    names = ["0000", "0001", "0002", "0003"]
    patterns = ["color/{}.jpg", "depth/{}.png", "depth/{}.npz", "confidence/{}.png"]
    patterns += ["labels/{}.png", "preview/{}.jpg", "own/depth/{}.png", "own/confidence/{}.png"]
    patterns += ["own/labels/{}.png", "own/depth/{}.npz"]
    wanted = {pattern.format(name) for pattern in patterns for name in names}
    wanted |= {"transforms.json", "classes.json", "metrics.json", "run.json"}
    assert set(files_of(out)) == wanted
    assert result.written == names and not result.kept and not result.skipped


def test_maps_have_the_promised_sizes_and_types(scene, truth, out: Path):
    predict_scene(FakeModel(), scene, out, save_npz=True)
    with Image.open(out / "depth/0001.png") as depth:
        assert depth.mode == "I;16" and depth.size == SIZE
        millimetres = np.array(depth).astype(float)
    with np.load(out / "depth/0001.npz") as stored:
        assert stored["depth"].dtype == np.float32
        np.testing.assert_allclose(millimetres, 1000 * stored["depth"], atol=0.51)
    with Image.open(out / "labels/0001.png") as labels:
        assert labels.mode == "P" and labels.size == SIZE
        assert labels.getpalette() == png_palette()
    assert (read(out / "own/confidence/0001.png") == 191).all()  # 0.75 * 255
    with Image.open(out / "preview/0001.jpg") as preview:
        assert preview.size == (3 * SIZE[0], SIZE[1] + LEGEND_HEIGHT)
    # The fake repeats the true depth at half the size; the walls' edges are a pixel wide.
    off = np.abs(millimetres / 1000 - truth[1].depth) / truth[1].depth
    assert np.quantile(off, 0.95) < 0.02


def test_transforms_json_holds_opengl_poses_and_the_photo_s_intrinsics(scene, truth, out: Path):
    predict_scene(FakeModel(), scene, out)
    frame = json.loads((out / "transforms.json").read_text())["frames"][2]
    opengl = truth[2].world_from_cam @ np.diag([1, -1, -1, 1])
    np.testing.assert_allclose(frame["transform_matrix"], opengl, atol=1e-6)
    (fl_x, _, cx), (_, fl_y, cy), _ = truth[2].intrinsics
    got = [frame[key] for key in ("w", "h", "fl_x", "fl_y", "cx", "cy")]
    np.testing.assert_allclose(got, [*SIZE, fl_x, fl_y, cx, cy], atol=1e-6)
    for key in ("file_path", "depth_file_path", "label_file_path", "confidence_file_path"):
        assert (out / frame[key]).is_file()


def test_run_json_says_what_made_the_folder(scene, out: Path):
    predict_scene(FakeModel(), scene, out, num_views=2, arguments={"scene": "room"})
    run = json.loads((out / "run.json").read_text())
    assert run["model"] == "FakeModel" and len(run["weights_hash"]) == 16
    assert run["arguments"] == {"scene": "room"} and run["num_views"] == 2
    assert {"mvsam", "torch", "numpy", "python"} <= set(run["versions"])
    assert {"read", "encode", "decode", "write"} <= set(run["seconds"])
    assert run["peak_memory_mb"]["ram"] > 1


def test_a_model_from_a_file_brings_its_name_hash_and_classes(scene, out: Path):
    model = FakeModel()
    model.info = SimpleNamespace(
        model="mine",
        classes=("red", "green", "blue"),
        palette=((9, 0, 0), (0, 9, 0), (0, 0, 9)),
        depth_range=(0.1, 5.0),
    )
    model.weights_hash = "0123456789abcdef"
    result = predict_scene(model, scene, out)
    run = json.loads((out / "run.json").read_text())
    assert (run["model"], run["weights_hash"]) == ("mine", "0123456789abcdef")
    classes = json.loads((out / "classes.json").read_text())
    assert classes[1] == {"name": "green", "color": [0, 9, 0]}
    with Image.open(out / "labels/0000.png") as labels:
        assert (labels.getpalette() or [])[:3] == [9, 0, 0]
    # Its classes are not those of the scene's label maps, so labels have no score.
    assert result.scores is not None and result.scores.total.labels is None


def test_metrics_json_scores_the_written_maps(scene, out: Path):
    result = predict_scene(FakeModel(), scene, out)
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["protocol"] == "paper"
    assert 0 < metrics["rel"] < 0.02  # the true depth, shrunk to the fake's size and back
    assert metrics["delta_1.05"] > 0.9
    assert list(metrics["scenes"]) == ["room"]
    assert result.scores is not None and result.scores.as_json() == metrics


def test_without_ground_truth_there_is_no_metrics_json(tmp_path: Path, out: Path):
    write_posed_folder(tmp_path / "bare", 3, SIZE, depth=False, labels=False)
    result = predict_scene(FakeModel(reads_depth=False), open_scene(tmp_path / "bare"), out)
    assert result.scores is None and not (out / "metrics.json").exists()


def test_a_task_the_model_lacks_leaves_no_files(scene, out: Path):
    predict_scene(WholeModel(), scene, out)
    assert {path.name for path in out.iterdir() if path.is_dir()} == {"color", "depth", "preview"}
    with Image.open(out / "preview/0000.jpg") as preview:
        assert preview.size == (2 * SIZE[0], SIZE[1] + LEGEND_HEIGHT)


def test_each_photo_is_encoded_once_for_all_tuples(scene, out: Path):
    model = FakeModel()
    predict_scene(model, scene, out)
    assert len(model.decoded) == 4 and model.encoded_views == 4


def test_a_second_run_skips_what_is_done(scene, out: Path):
    predict_scene(FakeModel(), scene, out)
    before = files_of(out)
    (out / "depth/0002.png").unlink()
    model = FakeModel()
    result = predict_scene(model, scene, out)
    assert result.written == ["0002"] and len(result.kept) == 3
    assert len(model.decoded) == 1
    after = files_of(out)
    assert after["color/0001.jpg"] == before["color/0001.jpg"]
    assert after["color/0002.jpg"] > before["color/0002.jpg"]


def test_overwrite_makes_everything_anew(scene, out: Path):
    predict_scene(FakeModel(), scene, out)
    result = predict_scene(FakeModel(), scene, out, overwrite=True)
    assert len(result.written) == 4


def test_maps_of_poses_since_corrected_are_not_kept(tmp_path: Path, scene, out: Path):
    predict_scene(FakeModel(), scene, out, references=["0000"])
    path = tmp_path / "room" / "poses" / "0003.txt"
    pose = np.loadtxt(path)
    pose[0, 3] += 0.01
    np.savetxt(path, pose)
    with pytest.raises(InputError, match=r"of other cameras.*--overwrite"):
        predict_scene(FakeModel(), open_scene(tmp_path / "room"), out)


def test_maps_of_a_photo_that_was_taken_again_are_not_kept(tmp_path: Path, scene, out: Path):
    predict_scene(FakeModel(), scene, out)
    (photo,) = (tmp_path / "room" / "color").glob("0002.*")
    picture = Image.open(photo).transpose(Image.Transpose.FLIP_LEFT_RIGHT)
    picture.save(photo)
    scene = open_scene(tmp_path / "room")
    with pytest.raises(InputError, match=r"predictions of another photo 0002.*--overwrite"):
        predict_scene(FakeModel(), scene, out)
    assert len(predict_scene(FakeModel(), scene, out, overwrite=True).written) == 4
    assert len(predict_scene(FakeModel(), scene, out).kept) == 4


def test_maps_made_at_another_size_are_not_kept(scene, out: Path):
    predict_scene(FakeModel(), scene, out)
    assert json.loads((out / "run.json").read_text())["size"] == [64, 48]
    with pytest.raises(InputError, match=r"with another --size.*--overwrite"):
        predict_scene(FakeModel(), scene, out, size=(96, 64))
    predict_scene(FakeModel(), scene, out, size=(96, 64), overwrite=True)
    assert json.loads((out / "run.json").read_text())["size"] == [96, 64]


@pytest.mark.parametrize("size", [(480, 360), (0, 256), (480,), 480, (480.0, 384.0), (320, 256, 3)])
def test_a_size_that_fits_no_network_is_refused(size):
    with pytest.raises(InputError, match=r"does not fit the network.*multiples of 32"):
        check_size(size)


def test_fewer_than_two_views_are_refused(scene, out: Path):
    with pytest.raises(InputError, match="1 view asked for: a prediction looks at 2 to 8"):
        predict_scene(FakeModel(), scene, out, num_views=1)


def test_another_model_does_not_mix_into_a_folder(scene, out: Path):
    predict_scene(FakeModel(), scene, out)
    with pytest.raises(InputError, match=r"model FakeModel, not WholeModel.*--overwrite"):
        predict_scene(WholeModel(), scene, out)
    predict_scene(WholeModel(), scene, out, overwrite=True, references=["0000"])
    assert not list((out / "labels").iterdir())
    assert [path.name for path in (out / "depth").iterdir()] == ["0000.png"]


def test_maps_of_a_model_that_changed_in_memory_are_not_kept(scene, out: Path):
    model = FakeModel()
    model.weights_hash = "of its file"
    predict_scene(model, scene, out)
    with torch.no_grad():
        model.scale.add_(1)
    with pytest.raises(InputError, match=r"of other weights.*--overwrite"):
        predict_scene(model, scene, out)


def test_the_scene_itself_is_never_written_into(scene, tmp_path: Path):
    before = files_of(tmp_path / "room")
    for overwrite in (False, True):
        with pytest.raises(InputError, match="choose another --out"):
            predict_scene(FakeModel(), scene, tmp_path / "room", overwrite=overwrite)
    assert files_of(tmp_path / "room") == before


def test_asking_for_npz_later_adds_it(scene, out: Path):
    predict_scene(FakeModel(), scene, out)
    predict_scene(FakeModel(), scene, out, save_npz=True)
    assert len(list((out / "depth").glob("*.npz"))) == 4


def test_ctrl_c_leaves_whole_files_and_the_next_run_continues(scene, out: Path):
    model = FakeModel()
    model.fail_at = (3, KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        predict_scene(model, scene, out)
    index = json.loads((out / "transforms.json").read_text())
    assert [Path(f["file_path"]).stem for f in index["frames"]] == ["0000", "0001"]
    result = predict_scene(FakeModel(), scene, out)
    assert result.kept == ["0000", "0001"] and result.written == ["0002", "0003"]
    assert len(json.loads((out / "transforms.json").read_text())["frames"]) == 4


def test_a_photo_that_was_killed_half_way_is_done_again(scene, out: Path):
    predict_scene(FakeModel(), scene, out)
    (out / "preview/0001.jpg").rename(out / "preview/.0001.jpg.0123abcd.part")
    assert predict_scene(FakeModel(), scene, out).written == ["0001"]
    assert not list(out.rglob("*.part"))


def test_a_full_disk_is_one_sentence_and_leaves_no_fragments(scene, out: Path, monkeypatch):
    class FullAfter:
        """Stands in for `os.replace`: the third label map finds no room."""

        def __call__(self, source, target):
            if "labels" in str(target) and "0002" in str(target):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.rename(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(mvsam.files.os, "replace", FullAfter())
        with pytest.raises(DiskFullError, match=r"disk is full: no room for .*labels/0002.png"):
            predict_scene(FakeModel(), scene, out)
    assert not list(out.rglob("*.part"))
    assert not (out / "labels/0002.png").exists()
    assert predict_scene(FakeModel(), scene, out).written == ["0002", "0003"]


def test_an_output_folder_that_cannot_be_written_is_named(scene, tmp_path: Path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match=r"file is a file, so there can be no .*file/out"):
        predict_scene(FakeModel(), scene, tmp_path / "file/out")


def test_references_choose_photos_by_name(scene, out: Path):
    result = predict_scene(FakeModel(), scene, out, references=["0002"])
    assert result.written == ["0002"]
    with pytest.raises(InputError, match=r"no photo named 002; it has 000"):
        predict_scene(FakeModel(), scene, out, references=["002"])


def test_a_run_for_one_photo_scores_all_that_are_done(scene, out: Path):
    predict_scene(FakeModel(), scene, out)
    before = (out / "metrics.json").read_text()
    again = predict_scene(FakeModel(), scene, out, references=["0000"])
    assert again.kept == ["0000"] and (out / "metrics.json").read_text() == before


def test_predicted_maps_are_not_taken_for_the_truth_of_a_scene(scene, out: Path, tmp_path: Path):
    predict_scene(FakeModel(), scene, out)
    again = open_scene(out)
    assert len(again) == len(scene) and again.frame(0).load_depth is None
    twice = predict_scene(FakeModel(reads_depth=False), again, tmp_path / "twice")
    assert twice.scores is None
    assert not (tmp_path / "twice/metrics.json").exists()


def test_a_model_of_single_pictures_looks_at_each_photo_alone(scene, out: Path):
    model = FakeModel()
    model.info = SimpleNamespace(model="fusenet", classes=(), palette=(), depth_range=(0.1, 5.0))
    assert len(predict_scene(model, scene, out).written) == 4
    assert [views.num_views for views in model.decoded] == [1] * 4


def test_a_model_that_was_trained_for_farther_depths_says_so(scene, out: Path, caplog):
    model = FakeModel()
    model.info = SimpleNamespace(model="tiny", classes=(), palette=(), depth_range=(0.3, 10.0))
    predict_scene(model, scene, out)
    assert "trained for 0.3 to 10 m, and 0.1 to 5 m are searched" in caplog.text


def test_sparse_points_beyond_the_range_are_warned_about(scene, out: Path, caplog):
    """As those of COLMAP's models, which have no unit."""
    scene.points = 5 * np.random.default_rng(0).normal(size=(20_000, 3))
    predict_scene(FakeModel(), scene, out, references=["0000"])
    assert "of its sparse points lie outside 0.1 to 5 m" in caplog.text
    scene.points *= 6
    with pytest.raises(InputError, match=r"100 % of its sparse points .* or --depth-range auto"):
        predict_scene(FakeModel(), scene, out, references=["0002"])
    caplog.clear()
    single = FakeModel()
    single.info = SimpleNamespace(
        model="tiny_semantic", classes=(), palette=(), depth_range=(0.1, 5.0)
    )
    predict_scene(single, scene, out / "labels", references=["0002"])  # it seeks no surface
    caplog.clear()
    scene.points = None
    predict_scene(FakeModel(), scene, out, references=["0001"])
    assert "sparse points" not in caplog.text


def test_skew_that_the_index_cannot_hold_is_warned_about(scene, out: Path, tmp_path, caplog):
    file = tmp_path / "room/intrinsics.txt"
    matrix = np.loadtxt(file)
    matrix[0, 1] = 4.0
    np.savetxt(file, matrix)
    predict_scene(FakeModel(), open_scene(tmp_path / "room"), out)
    assert "have a skew" in caplog.text


def test_foreign_fragments_in_the_output_folder_are_left_alone(scene, out: Path):
    (out / "kept").mkdir(parents=True)
    (out / "kept/.download.part").touch()
    predict_scene(FakeModel(), scene, out)
    assert (out / "kept/.download.part").exists()


def test_another_precision_does_not_mix_into_a_folder(scene, out: Path):
    predict_scene(FakeModel(), scene, out, precision="float32")
    with pytest.raises(InputError, match="precision float32"):
        predict_scene(FakeModel(), scene, out, precision="bfloat16")


def test_a_photo_that_overlaps_no_other_is_skipped_and_named(tmp_path: Path, out: Path, caplog):
    write_posed_folder(tmp_path / "room", 4, SIZE)
    away = np.diag([-1.0, 1, -1, 1])  # looks backwards
    np.savetxt(tmp_path / "room/poses/0003.txt", away)
    with caplog.at_level(logging.WARNING, "mvsam"):
        result = predict_scene(FakeModel(), open_scene(tmp_path / "room"), out)
    assert result.skipped == ["0003"] and "0003" in caplog.text
    assert result.written == ["0000", "0001", "0002"]
    with pytest.raises(InputError, match="none of the references 0003"):
        predict_scene(FakeModel(), open_scene(tmp_path / "room"), out, references=["0003"])


def test_measured_depth_warns_of_intrinsics_for_another_size(tmp_path: Path, out: Path, caplog):
    write_posed_folder(tmp_path / "room", 4, SIZE)
    file = tmp_path / "room" / "intrinsics.txt"
    np.savetxt(file, np.loadtxt(file) * [[0.5], [0.5], [1]])
    with caplog.at_level(logging.WARNING, "mvsam"):
        predict_scene(FakeModel(), open_scene(tmp_path / "room"), out, references=["0001"])
    assert "intrinsics for photos of half the size" in caplog.text
    assert "of the surfaces then meet" in caplog.text


def test_a_photo_without_the_depth_that_the_model_reads_is_found_before_work(
    tmp_path: Path, scene, out: Path
):
    model = FakeModel()
    model.reads_depth = True
    predict_scene(model, scene, out)
    (tmp_path / "room/depth/0002.png").unlink()
    with pytest.raises(InputError, match=r"0002: has no measured depth.*take a model of RGB views"):
        predict_scene(model, open_scene(tmp_path / "room"), tmp_path / "again")
    assert not (tmp_path / "again").exists()
    predict_scene(model, open_scene(tmp_path / "room"), tmp_path / "again", references=["0001"])


def test_progress_counts_every_reference(scene, out: Path):
    seen = []
    predict_scene(FakeModel(), scene, out, on_photo=lambda *step: seen.append(step))
    assert seen == [(i + 1, 4, f"000{i}") for i in range(4)]


def test_the_same_numbers_in_another_network_are_another_run():
    smooth, blocks = FeaturePyramid(upsampling="bilinear"), FeaturePyramid()
    smooth.load_state_dict(blocks.state_dict())
    assert hash_of_values(smooth) != hash_of_values(blocks)
    assert hash_of_values(blocks) == hash_of_values(deepcopy(blocks))
