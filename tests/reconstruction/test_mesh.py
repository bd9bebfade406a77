import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mvsam.commands.reconstruct import Reconstruct
from mvsam.errors import InputError, MissingExtraError
from mvsam.reconstruction.cloud import build_cloud
from mvsam.reconstruction.export import colored_by_label, write_model
from mvsam.reconstruction.folder import read_predictions
from mvsam.reconstruction.mesh import FEWEST_TRIANGLES, Mesh, _large_pieces, build_mesh
from mvsam.reconstruction.settings import CloudSettings
from tests.reconstruction.test_filtering import distance_to_walls

SETTINGS = CloudSettings(voxel_size=0.05)


@pytest.fixture
def mesh(folder: Path) -> Mesh:
    return build_mesh(read_predictions(folder), SETTINGS)


def test_true_depths_rebuild_the_room(mesh: Mesh):
    assert distance_to_walls(mesh.vertices.points).max() < 0.05
    assert np.quantile(distance_to_walls(mesh.vertices.points), 0.9) < 0.01


def test_vertices_carry_what_the_nearest_point_of_the_cloud_does(folder: Path, mesh: Mesh):
    cloud = build_cloud(read_predictions(folder), SETTINGS)
    for index in range(0, len(mesh.vertices), 97):
        nearest = np.linalg.norm(cloud.points - mesh.vertices.points[index], axis=1).argmin()
        assert mesh.vertices.labels[index] == cloud.labels[nearest]
        np.testing.assert_array_equal(mesh.vertices.colors[index], cloud.colors[nearest])
    assert len(np.unique(mesh.vertices.labels)) > 1


def test_every_vertex_is_used_once(mesh: Mesh):
    assert np.array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    assert len(np.unique(mesh.vertices.points, axis=0)) == len(mesh.vertices)


def test_specks_are_left_out():
    large = trimesh.creation.icosphere(subdivisions=3)
    speck = trimesh.creation.icosphere(subdivisions=1)
    speck.apply_translation((5, 0, 0))
    assert len(speck.faces) < FEWEST_TRIANGLES < len(large.faces)
    vertices, faces = _large_pieces(
        np.concatenate([large.vertices, speck.vertices]),
        np.concatenate([large.faces, speck.faces + len(large.vertices)]),
    )
    assert len(faces) == len(large.faces) and vertices[:, 0].max() < 2


def test_a_mesh_of_nothing_says_what_to_do(folder: Path):
    with pytest.raises(InputError, match="no surface is left: lower --minimum-confidence"):
        build_mesh(read_predictions(folder), CloudSettings(minimum_consistent_views=4))


@pytest.mark.parametrize("ending", ["ply", "glb"])
def test_files_read_back_with_trimesh(mesh: Mesh, tmp_path: Path, ending: str):
    write_model(tmp_path / f"room.{ending}", mesh)
    read = trimesh.load_mesh(tmp_path / f"room.{ending}", process=False)
    assert isinstance(read, trimesh.Trimesh)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    np.testing.assert_allclose(read.vertices, mesh.vertices.points, atol=1e-6)
    colors = getattr(read.visual, "vertex_colors")[:, :3]  # noqa: B009, trimesh types it too widely
    np.testing.assert_array_equal(colors, mesh.vertices.colors)
    if ending == "ply":
        stored = read.metadata["_ply_raw"]["vertex"]["data"]
        np.testing.assert_array_equal(np.ravel(stored["label"]), mesh.vertices.labels)


def test_a_mesh_can_have_the_colours_of_its_classes(mesh: Mesh):
    palette = np.random.default_rng(0).integers(0, 256, (256, 3)).astype(np.uint8)
    colored = colored_by_label(mesh, palette)
    assert isinstance(colored, Mesh)
    np.testing.assert_array_equal(colored.vertices.colors, palette[mesh.vertices.labels])
    np.testing.assert_array_equal(colored.faces, mesh.faces)


def test_the_command_writes_a_mesh_and_counts_triangles(folder: Path, tmp_path: Path, capsys):
    out = tmp_path / "room.glb"
    Reconstruct(folder, out, mesh=True, color="label", settings=SETTINGS).run()
    assert "triangles" in capsys.readouterr().out
    read = trimesh.load_mesh(out)
    assert isinstance(read, trimesh.Trimesh) and len(read.faces) > 1000


def test_without_trimesh_the_extra_is_named(folder: Path, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'mvsam\[reconstruct\]'"):
        build_mesh(read_predictions(folder), SETTINGS)
