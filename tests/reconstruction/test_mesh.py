import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from mvsam.commands.reconstruct import Reconstruct
from mvsam.errors import InputError, MissingExtraError
from mvsam.reconstruction.cloud import build_cloud
from mvsam.reconstruction.export import colored_by_label, linear_light, write_model
from mvsam.reconstruction.folder import read_predictions
from mvsam.reconstruction.mesh import FEWEST_TRIANGLES, Mesh, _large_pieces, build_mesh
from mvsam.reconstruction.settings import CloudSettings
from tests.reconstruction.glb import glb_colors
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
        build_mesh(read_predictions(folder), CloudSettings(relative_tolerance=0.0))


def test_photos_too_few_to_confirm_each_other_are_told_apart(folder: Path):
    views = read_predictions(folder)[:1]
    for build in (build_mesh, build_cloud):
        with pytest.raises(InputError, match="no more than 1 photo with depth can agree"):
            build(views, CloudSettings())


def test_a_photo_weighs_as_much_as_it_is_confident(folder: Path):
    views = read_predictions(folder)[:2]
    sure, unsure = np.full((96, 128), 255, np.uint8), np.full((96, 128), 26, np.uint8)
    for view, confidence, factor in zip(views, (sure, unsure), (1.0, 1.02), strict=True):
        assert view.confidence_path is not None
        Image.fromarray(confidence).save(view.confidence_path)
        with Image.open(view.depth_path) as picture:
            depth = np.array(picture)
        Image.fromarray((depth * factor).astype(np.uint16)).save(view.depth_path)
    settings = CloudSettings(voxel_size=0.05, minimum_confidence=0.0)
    both = distance_to_walls(build_mesh(views, settings).vertices.points)
    alone = distance_to_walls(
        build_mesh(views[1:], replace(settings, minimum_consistent_views=0)).vertices.points
    )
    assert np.median(both) < 0.2 * np.median(alone)


@pytest.mark.parametrize("library", ["skimage.measure", "scipy.spatial", "trimesh"])
def test_a_missing_library_is_named_before_any_work(folder: Path, monkeypatch, library: str):
    monkeypatch.setitem(sys.modules, library, None)
    photos = []
    with pytest.raises(MissingExtraError, match=r"pip install 'mvsam\[reconstruct\]'"):
        build_mesh(read_predictions(folder), SETTINGS, lambda name, share: photos.append(name))
    assert not photos


@pytest.mark.parametrize("ending", ["ply", "glb"])
def test_files_read_back_with_trimesh(mesh: Mesh, tmp_path: Path, ending: str):
    write_model(tmp_path / f"room.{ending}", mesh)
    read = trimesh.load_mesh(tmp_path / f"room.{ending}", process=False)
    assert isinstance(read, trimesh.Trimesh)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    np.testing.assert_allclose(read.vertices, mesh.vertices.points, atol=1e-6)
    if ending == "glb":
        colors = glb_colors(tmp_path / "room.glb")
        np.testing.assert_array_equal(colors[:, :3], linear_light(mesh.vertices.colors))
    else:
        colors = getattr(read.visual, "vertex_colors")  # noqa: B009, trimesh types it too widely
        np.testing.assert_array_equal(colors[:, :3], mesh.vertices.colors)
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
