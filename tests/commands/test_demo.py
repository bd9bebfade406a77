import json
import sys
from pathlib import Path

import trimesh

from mvsam import weights
from mvsam.cli import main
from mvsam.commands import demo
from tests.inference.fake_model import FakeModel
from tests.synthetic import write_posed_folder


def test_demo_writes_maps_scores_clouds_a_mesh_and_a_page(tmp_path: Path, monkeypatch, capsys):
    write_posed_folder(tmp_path / "sample", 5, (128, 96))
    monkeypatch.setattr(demo, "SAMPLE", tmp_path / "sample")
    monkeypatch.setattr(weights, "load", lambda name: FakeModel())
    out = tmp_path / "demo"
    for _ in range(2):  # a second demo replaces the first
        assert main(["demo", "--out", str(out), "--device", "cpu"]) == 0
    said = capsys.readouterr().out
    assert "protocol: paper" in said and str(out / "preview") in said
    assert json.loads((out / "metrics.json").read_text())["num_images"] == 5
    assert len(list((out / "preview").iterdir())) == 5
    for name in ("room.ply", "room_labels.ply"):
        cloud = trimesh.load(out / name)
        assert isinstance(cloud, trimesh.PointCloud) and len(cloud.vertices) > 500
    assert "room.glb" in said and "triangles" in said
    assert "<canvas" in (out / "report.html").read_text()
    assert len(trimesh.load_mesh(out / "room.glb").faces) > 500


def test_a_plain_installation_s_demo_goes_without_a_mesh(tmp_path: Path, monkeypatch, capsys):
    write_posed_folder(tmp_path / "sample", 5, (128, 96))
    monkeypatch.setattr(demo, "SAMPLE", tmp_path / "sample")
    monkeypatch.setattr(weights, "load", lambda name: FakeModel())
    monkeypatch.setitem(sys.modules, "skimage.measure", None)
    assert main(["demo", "--out", str(tmp_path / "demo"), "--device", "cpu"]) == 0
    assert "pip install 'mvsam[reconstruct]'" in capsys.readouterr().out
    assert (tmp_path / "demo" / "report.html").is_file()
