import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mvsam.errors import InputError, MissingExtraError
from mvsam.reconstruction.cloud import PointCloud
from mvsam.reconstruction.export import colored_by_label, linear_light, write_model
from tests.reconstruction.glb import glb_tree


@pytest.fixture
def cloud() -> PointCloud:
    random = np.random.default_rng(1)
    return PointCloud(
        points=random.normal(size=(50, 3)).astype(np.float32),
        colors=random.integers(0, 256, (50, 3)).astype(np.uint8),
        labels=random.integers(0, 20, 50).astype(np.uint8),
        confidence=random.random(50).astype(np.float32),
    )


def test_ply_reads_back_with_trimesh(cloud: PointCloud, tmp_path: Path):
    write_model(tmp_path / "room.ply", cloud)
    read = trimesh.load(tmp_path / "room.ply")
    assert isinstance(read, trimesh.PointCloud)
    np.testing.assert_array_equal(read.vertices, cloud.points)
    np.testing.assert_array_equal(np.asarray(read.colors)[:, :3], cloud.colors)
    stored = read.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(np.ravel(stored["label"]), cloud.labels)
    np.testing.assert_array_equal(np.ravel(stored["confidence"]), cloud.confidence)


def test_ply_header_names_every_property(cloud: PointCloud, tmp_path: Path):
    write_model(tmp_path / "room.ply", cloud)
    header, _, body = (tmp_path / "room.ply").read_bytes().partition(b"end_header\n")
    assert b"format binary_little_endian 1.0\n" in header and b"element vertex 50\n" in header
    assert b"property float x\n" in header and b"property uchar label\n" in header
    assert len(body) == 50 * (3 * 4 + 3 + 1 + 4)


def test_glb_reads_back_with_trimesh(cloud: PointCloud, tmp_path: Path):
    write_model(tmp_path / "room.glb", cloud)
    scene = trimesh.load(tmp_path / "room.glb")
    assert isinstance(scene, trimesh.Scene)
    (points,) = scene.geometry.values()
    np.testing.assert_allclose(points.vertices, cloud.points, atol=1e-6)
    np.testing.assert_array_equal(np.asarray(points.colors)[:, :3], linear_light(cloud.colors))


def test_glb_shows_the_colours_of_the_photos_as_they_are(cloud: PointCloud, tmp_path: Path):
    write_model(tmp_path / "room.glb", cloud)
    tree = glb_tree(tmp_path / "room.glb")
    (primitive,) = tree["meshes"][0]["primitives"]
    assert "KHR_materials_unlit" in tree["materials"][primitive["material"]]["extensions"]
    assert tree["extensionsUsed"] == ["KHR_materials_unlit"]


def test_linear_light_is_that_of_srgb():
    colors = np.array([[0, 255, 188], [10, 128, 99]], np.uint8)  # half of the light is 188
    np.testing.assert_array_equal(linear_light(colors), [[0, 255, 128], [1, 55, 32]])


def test_a_folder_is_no_target(cloud: PointCloud, tmp_path: Path):
    (tmp_path / "room.ply").mkdir()
    with pytest.raises(InputError, match=r"room\.ply is a folder"):
        write_model(tmp_path / "room.ply", cloud)


def test_glb_without_trimesh_names_the_extra(cloud: PointCloud, tmp_path: Path, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'mvsam\[reconstruct\]'"):
        write_model(tmp_path / "room.glb", cloud)
    assert not list(tmp_path.iterdir())


def test_other_endings_are_refused(cloud: PointCloud, tmp_path: Path):
    with pytest.raises(InputError, match=r"room\.obj must end in \.ply or \.glb"):
        write_model(tmp_path / "room.obj", cloud)


def test_colouring_by_label_takes_the_palette_s_colours(cloud: PointCloud):
    palette = np.arange(768, dtype=np.uint32).reshape(256, 3).astype(np.uint8)
    colored = colored_by_label(cloud, palette)
    assert isinstance(colored, PointCloud)
    np.testing.assert_array_equal(colored.colors, palette[cloud.labels])
