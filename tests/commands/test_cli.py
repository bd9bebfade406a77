import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mvsam import weights
from mvsam.build import MODELS
from mvsam.cli import main
from mvsam.data.keyframes import keyframes as keyframes_of
from mvsam.files import DiskFullError
from tests.data.readers.test_scannet import write_raw
from tests.inference.fake_model import FakeModel
from tests.synthetic import write_posed_folder


@pytest.fixture
def model(monkeypatch) -> FakeModel:
    """The model that every name stands for here."""
    fake = FakeModel()
    monkeypatch.setattr(weights, "load", lambda name: fake)
    return fake


@pytest.fixture
def room(tmp_path: Path) -> str:
    write_posed_folder(tmp_path / "room", 4, (128, 96))
    return str(tmp_path / "room")


def predict(room: str, tmp_path: Path, *options: str) -> int:
    return main(["predict", room, "--out", str(tmp_path / "out"), "--device", "cpu", *options])


def test_help_names_every_verb_without_loading_torch(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for verb in (
        "demo",
        "predict",
        "train",
        "eval",
        "table",
        "models",
        "bench",
        "reconstruct",
        "rooms",
    ):
        assert f" {verb} " in text
    code = "import mvsam.cli, sys; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize("option", ["--version", "--help"])
def test_output_that_nobody_reads_on_ends_quietly(option):
    """As `mvsam ... | head`: the reading end of the pipe is closed before we write."""
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "mvsam.cli", option]
    ended = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert (ended.returncode, ended.stderr) == (141, "")


@pytest.mark.parametrize(
    "verb",
    [
        "demo",
        "predict",
        "train",
        "eval",
        "models",
        "bench",
        "export",
        "table",
        "reconstruct",
        "rooms preview",
        "rooms export",
        "data check",
        "data convert",
        "data scannet",
    ],
)
def test_each_verb_explains_itself_with_an_example(verb: str, capsys):
    assert main([*verb.split(), "--help"]) == 0
    assert f"Example: mvsam {verb}" in " ".join(capsys.readouterr().out.split())


def test_version_is_printed(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("mvsam 0.")


@pytest.mark.parametrize("arguments", [["fly"], ["predict"], ["predict", "x", "--nope"], []])
def test_a_wrong_command_line_ends_with_2(arguments: list[str], capsys):
    assert main(arguments) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_predict_finds_a_depth_range_by_itself(model: FakeModel, room: str, tmp_path: Path):
    assert predict(room, tmp_path, "--depth-range", "auto") == 0
    record = json.loads((tmp_path / "out" / "run.json").read_text())
    assert record["depth_range"] == [0.1, 5.0] and record["arguments"]["depth_range"] == "auto"


def test_predict_then_reconstruct(model: FakeModel, room: str, tmp_path: Path, capsys):
    assert predict(room, tmp_path, "--views", "2", "--depth-range", "0.2", "6") == 0
    assert "4 photos predicted" in capsys.readouterr().out
    run = json.loads((tmp_path / "out/run.json").read_text())
    assert run["num_views"] == 2 and run["depth_range"] == [0.2, 6.0]
    assert run["arguments"]["scene"] == room
    assert predict(room, tmp_path, "--views", "2", "--depth-range", "0.2", "6") == 0
    assert "0 photos predicted, 4 done before" in capsys.readouterr().out
    ply = tmp_path / "room.ply"
    fuse = ["reconstruct", str(tmp_path / "out"), "--voxel-size", "0.05", "--out"]
    assert main([*fuse, str(ply)]) == 0
    assert re.search(r"points; \d+% of .* least of 000\d: \d+%", capsys.readouterr().out)
    assert main([*fuse, str(tmp_path / "room.glb"), "--color", "label"]) == 0
    by_photo = trimesh.load(ply)
    assert isinstance(by_photo, trimesh.PointCloud) and len(by_photo.vertices) > 500
    (by_label,) = trimesh.load(tmp_path / "room.glb").geometry.values()  # pyright: ignore
    assert len(np.unique(by_label.colors, axis=0)) <= 3  # the fake knows three classes


def test_several_scenes_get_a_folder_each(model: FakeModel, tmp_path: Path):
    for name in ("a", "b"):
        write_posed_folder(tmp_path / "rooms" / name, 2, (128, 96))
    assert predict(str(tmp_path / "rooms"), tmp_path) == 0
    assert (tmp_path / "out/a/metrics.json").is_file()
    assert (tmp_path / "out/b/metrics.json").is_file()


def test_one_broken_scene_does_not_stop_the_others(model: FakeModel, tmp_path: Path, capsys):
    for name in ("a", "b", "c"):
        write_posed_folder(tmp_path / "rooms" / name, 2, (128, 96))
    np.savetxt(tmp_path / "rooms/b/poses/0001.txt", 2 * np.eye(4))
    assert predict(str(tmp_path / "rooms"), tmp_path) == 2
    assert "1 of 3 scenes failed" in capsys.readouterr().err
    assert (tmp_path / "out/a/metrics.json").is_file()
    assert (tmp_path / "out/c/metrics.json").is_file()
    assert main(["data", "check", str(tmp_path / "rooms")]) == 2
    checked = capsys.readouterr()
    assert "a: 2 photos" in checked.out and "c: 2 photos" in checked.out
    assert "1 of 3 scenes failed" in checked.err


def test_a_scene_is_not_its_own_output(model: FakeModel, room: str, tmp_path: Path, capsys):
    assert predict(room, tmp_path) == 0
    out = tmp_path / "out"
    before = sorted(out.rglob("*"))
    assert predict(str(out), tmp_path, "--overwrite") == 2
    assert "is the scene itself" in capsys.readouterr().err
    assert sorted(out.rglob("*")) == before


def test_a_demo_does_not_replace_other_predictions(
    model: FakeModel, room: str, tmp_path: Path, capsys
):
    assert predict(room, tmp_path) == 0
    assert main(["demo", "--out", str(tmp_path / "out"), "--device", "cpu"]) == 2
    assert "holds predictions of scene room" in capsys.readouterr().err


def test_skipped_photos_are_warned_about_on_stderr(model, room: str, tmp_path: Path, capsys):
    np.savetxt(Path(room) / "poses/0003.txt", np.diag([-1.0, 1, -1, 1]))
    assert predict(room, tmp_path) == 0
    captured = capsys.readouterr()
    assert "warning: " in captured.err and "0003" in captured.err
    assert "3 photos predicted, 1 skipped" in captured.out


def test_predict_keeps_a_record_of_its_limits(model: FakeModel, room: str, tmp_path: Path):
    options = ["--precision", "float32", "--max-memory", "100"]
    assert predict(room, tmp_path, *options) == 0
    run = json.loads((tmp_path / "out/run.json").read_text())
    assert run["precision"] == "float32"
    assert run["arguments"]["max_memory"] == 100 and run["arguments"]["feature_cache"] is None


def test_predict_says_which_memory_limit_would_do(model: FakeModel, room: str, tmp_path, capsys):
    assert predict(room, tmp_path, "--max-memory", "0.01") == 2
    assert "a memory limit of 0.01 GB is too little" in capsys.readouterr().err


def test_a_memory_limit_is_a_number(model: FakeModel, room: str, tmp_path: Path, capsys):
    assert predict(room, tmp_path, "--max-memory", "nan") == 2
    assert "give gigabytes, as 2.5" in capsys.readouterr().err


def test_only_a_model_with_a_frozen_encoder_has_features_to_keep(
    model: FakeModel, room: str, tmp_path, capsys
):
    assert predict(room, tmp_path, "--feature-cache", str(tmp_path / "kept")) == 2
    assert "has no SAM encoder" in capsys.readouterr().err


def test_eval_prints_the_scores_as_json(model: FakeModel, room: str, capsys):
    model.input_size = (320, 256)
    assert main(["eval", "any", "--data", room, "--json", "--limit", "2", "--device", "cpu"]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["protocol"] == "paper" and scores["num_images"] == 2
    assert scores["rel"] < 1e-6  # the fake repeats the measured depth
    assert {"abs", "rmse", "delta_1.03", "delta_1.05", "delta_1.25", "miou"} <= set(scores)
    assert set(scores["scenes"]) == {"room"}


def test_eval_as_json_says_what_was_measured(model: FakeModel, room: str, capsys):
    options = ["--data", room, "--views", "2", "--size", "64", "96", "--limit", "1"]
    assert main(["eval", "any", *options, "--json", "--device", "cpu"]) == 0
    page = json.loads(capsys.readouterr().out)
    assert (page["model"], page["data"], page["num_views"]) == ("any", room, 2)
    assert (page["size"], page["depth_range"], page["poses"]) == ([64, 96], [0.1, 5.0], "given")
    assert {"command", "commit", "date", "device", "versions"} <= set(page)


def test_eval_of_a_model_that_reads_depth_asks_for_it(model: FakeModel, tmp_path: Path, capsys):
    model.reads_depth = True
    write_posed_folder(tmp_path / "room", 4, (128, 96), depth=False)
    assert main(["eval", "any", "--data", str(tmp_path / "room"), "--device", "cpu"]) == 2
    assert "has no measured depth" in capsys.readouterr().err


def test_eval_does_not_score_labels_of_other_classes(model: FakeModel, room: str, capsys, caplog):
    names = [{"name": name, "color": [n, 0, 0]} for n, name in enumerate(("sky", "road", "car"))]
    (Path(room) / "classes.json").write_text(json.dumps(names))
    assert main(["eval", "any", "--data", room, "--json", "--limit", "1", "--device", "cpu"]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["miou"] is None and scores["rel"] is not None
    assert "its 3 classes are not the model's 20" in caplog.text


def test_eval_without_ground_truth_says_so(model: FakeModel, tmp_path: Path, capsys):
    model.reads_depth = False
    write_posed_folder(tmp_path / "bare", 4, (128, 96), depth=False, labels=False)
    assert main(["eval", "any", "--data", str(tmp_path / "bare"), "--device", "cpu"]) == 2
    assert "no depth or labels to score any by" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--limit", "0"], "--limit 0: give 1 or more"),
        (["--views", "1"], "--views 1: any looks at 2 photos or more"),
        (["--views", "0"], "--views 0: any looks at 2 photos or more"),
        (["--depth-range", "5", "0.1"], "the depth range 5 0.1 is not one"),
    ],
)
def test_eval_refuses_what_cannot_be(options, complaint: str, model, room: str, capsys):
    assert main(["eval", "any", "--data", room, "--device", "cpu", *options]) == 2
    assert complaint in capsys.readouterr().err


def test_eval_prints_a_table(model: FakeModel, room: str, capsys):
    assert main(["eval", "any", "--data", room, "--device", "cpu"]) == 0
    out = capsys.readouterr().out
    assert "protocol: paper" in out and "total" in out


def test_models_lists_every_model_as_json(capsys):
    assert main(["models", "--json"]) == 0
    models = {model["name"]: model for model in json.loads(capsys.readouterr().out)}
    assert set(models) == set(MODELS)
    assert models["base"]["parameters"] == 94_220_588
    assert models["cas_mvsnet"]["tasks"] == ["depth"]


def test_rooms_export_writes_posed_folders_and_preview_a_picture(tmp_path: Path):
    assert main(["rooms", "export", "rooms:val:0-1", "--out", str(tmp_path / "rooms")]) == 0
    (folder,) = (tmp_path / "rooms").iterdir()
    assert (folder / "views.txt").is_file() and len(list((folder / "color").iterdir())) == 5
    picture = tmp_path / "sheet.png"
    assert main(["rooms", "preview", "rooms:val:0-1", "--out", str(picture)]) == 0
    assert picture.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["predict", "nowhere", "--out", "out", "--model", "tinny"], "unknown model 'tinny'"),
        (["reconstruct", "nowhere", "--out", "room.ply"], "nowhere is no folder"),
        (["reconstruct", "nowhere", "--out", "room.stl"], "must end in .ply or .glb"),
        (["eval", "tiny", "--protocol", "scanet"], "unknown protocol 'scanet'"),
        (["rooms", "preview", "elsewhere"], "does not name rooms"),
        (["train", "tinny"], "unknown run 'tinny'"),
        (["export", "tiny", "--out", "tiny.pt"], "tiny.pt must end in .onnx"),
        (["report", "nowhere", "--out", "page.txt"], "page.txt must end in .html"),
        (["predict", "x", "--out", "y", "--model", "tiny_nyu"], "Did you mean 'tiny-nyu'?"),
    ],
)
def test_bad_input_is_one_sentence_and_ends_with_2(arguments, complaint: str, capsys, tmp_path):
    assert main(arguments) == 2
    captured = capsys.readouterr()
    (line,) = captured.err.strip().splitlines()
    assert line.startswith("error: ") and complaint in line
    assert captured.out == ""


@pytest.mark.parametrize(
    ("failure", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "the same command goes on"),
        (DiskFullError("the disk is full: no room for x"), 1, "error: the disk is full: no room"),
        (ZeroDivisionError("by\nnothing"), 1, "ZeroDivisionError: by nothing (--debug"),
    ],
)
def test_failures_are_one_sentence(failure, code: int, said: str, model, room, tmp_path, capsys):
    model.fail_at = (2, failure)
    assert predict(room, tmp_path) == code
    error = capsys.readouterr().err
    assert said in error and "Traceback" not in error
    model.fail_at = None
    assert predict(room, tmp_path) == 0
    assert "3 photos predicted, 1 done before" in capsys.readouterr().out


def test_debug_shows_the_traceback(model, room: str, tmp_path: Path, capsys):
    model.fail_at = (1, ZeroDivisionError("by nothing"))
    assert predict(room, tmp_path, "--debug") == 1
    assert "Traceback" in capsys.readouterr().err


def test_data_check_tells_what_is_wrong_and_convert_writes_another_form(tmp_path: Path, capsys):
    folder = tmp_path / "room"
    write_posed_folder(folder, num_frames=5)
    assert main(["data", "check", str(folder), "--strict"]) == 0
    assert "the cameras fit." in capsys.readouterr().out
    for pose in (folder / "poses").iterdir():
        np.savetxt(pose, np.linalg.inv(np.loadtxt(pose)))
    assert main(["data", "check", str(folder), "--json"]) == 0
    (report,) = json.loads(capsys.readouterr().out)
    assert report["is_suspicious"] and "invert" in report["depth_verdict"]["sentence"]
    assert main(["data", "check", str(folder), "--strict"]) == 1
    assert "the cameras are wrong" in capsys.readouterr().out
    out = tmp_path / "other"
    assert main(["data", "convert", str(folder), "--out", str(out), "--to", "nerfstudio"]) == 0
    assert len(json.loads((out / "transforms.json").read_text())["frames"]) == 5
    assert main(["data", "convert", str(folder), "--out", str(folder)]) == 2


def test_data_check_counts_the_frames_that_lost_tracking(tmp_path: Path, capsys):
    write_raw(tmp_path / "scan", lost=1)
    assert main(["data", "check", str(tmp_path / "scan")]) == 0
    assert "2 photos of 64x48, 1 more without a pose" in capsys.readouterr().out
    assert main(["data", "check", str(tmp_path / "scan"), "--scale", "2", "--json"]) == 0
    (report,) = json.loads(capsys.readouterr().out)
    assert (report["num_frames"], report["num_lost"]) == (2, 1)


@pytest.mark.parametrize("depth_range", [("0.1", "5"), ("auto",)])
def test_of_a_stream_only_the_keyframes_are_predicted(tmp_path, model, capsys, depth_range):
    frames = write_posed_folder(tmp_path / "room", 4, (128, 96))
    close = frames[1].world_from_cam.copy()
    close[:3, 3] = frames[0].world_from_cam[:3, 3] + [0.02, 0, 0]
    close[:3, :3] = frames[0].world_from_cam[:3, :3]
    np.savetxt(tmp_path / "room/poses/0001.txt", close)
    room = str(tmp_path / "room")
    keyframes = ("--tuples", "keyframes", "--depth-range", *depth_range)
    assert predict(room, tmp_path, *keyframes) == 0
    names = {file.stem for file in (tmp_path / "out/depth").iterdir()}
    poses = [np.loadtxt(tmp_path / f"room/poses/000{n}.txt") for n in range(4)]
    assert names == {f"000{n}" for n in keyframes_of(poses)} and "0001" not in names
    assert predict(room, tmp_path, "--depth-range", *depth_range) == 2
    assert "holds predictions made from other view tuples" in capsys.readouterr().err


def test_a_measured_distance_scales_the_cameras_that_predict_writes(room, tmp_path, model, capsys):
    assert predict(room, tmp_path, "--scale", "0000.jpg:0003.jpg=0.6") == 0
    assert "one unit of the poses is" in capsys.readouterr().err
    frames = json.loads((tmp_path / "out/transforms.json").read_text())["frames"]
    place = {Path(f["file_path"]).stem: np.array(f["transform_matrix"])[:3, 3] for f in frames}
    assert np.linalg.norm(place["0000"] - place["0003"]) == pytest.approx(0.6, abs=1e-6)
