import numpy as np
import pytest
import trimesh

from mvsam.errors import InputError
from mvsam.reconstruction.filtering import back_project, project
from mvsam.reconstruction.tsdf import EDGE, TsdfVolume
from tests.reconstruction.test_filtering import Camera, distance_to_walls
from tests.reference.tsdf import fused_distance
from tests.synthetic import synthetic_views

VOXEL = 0.05


def box_room(num_views: int = 4) -> TsdfVolume:
    volume = TsdfVolume(VOXEL)
    for view in synthetic_views(num_views):
        volume.add(Camera(view), view.depth, np.ones_like(view.depth))
    return volume


def test_every_voxel_holds_what_the_reference_says():
    random = np.random.default_rng(3)
    views = synthetic_views(3)
    cameras = [Camera(view) for view in views]
    depths = [np.where(random.random(view.depth.shape) < 0.1, 0, view.depth) for view in views]
    depths = [depth * random.uniform(0.97, 1.03, depth.shape) for depth in depths]
    weights = [random.uniform(0.1, 1, depth.shape) for depth in depths]
    volume = TsdfVolume(VOXEL)
    for maps in zip(cameras, depths, weights, strict=True):
        volume.add(*maps)
    blocks = list(volume._blocks)
    near = [set(volume._blocks_near(*pair)) for pair in zip(cameras, depths, strict=True)]
    known = 0
    for _ in range(2000):
        block = blocks[random.integers(len(blocks))]
        place = tuple(random.integers(0, EDGE, 3))
        centre = (np.multiply(block, EDGE) + place + 0.5) * VOXEL
        distance, weight = volume._blocks[block][:, *place]
        # A block that no depth of a map came near keeps what the other maps say of it.
        seen = [i for i in range(3) if block in near[i]]
        parts = [[part[i] for i in seen] for part in (cameras, depths, weights)]
        mean, total = fused_distance(centre, *parts, truncation=4 * VOXEL)
        assert weight == pytest.approx(total, rel=1e-5)
        assert distance == pytest.approx(1.0 if mean is None else mean, abs=1e-5)
        known += mean is not None
    assert known > 500


def test_true_depths_rebuild_the_walls():
    vertices, faces = box_room().surface()
    used = vertices[np.unique(faces)]
    assert len(faces) > 5000
    # A surface is round where walls meet.
    assert np.quantile(distance_to_walls(used), 0.5) < 1e-3 * VOXEL
    assert np.quantile(distance_to_walls(used), 0.9) < 0.2 * VOXEL
    assert distance_to_walls(used).max() < VOXEL


def test_triangles_face_the_cameras():
    vertices, faces = box_room(1).surface()
    a, b, c = vertices[faces].transpose(1, 0, 2)
    camera = Camera(synthetic_views(1)[0])
    towards = np.sum(np.cross(b - a, c - a) * (camera.world_from_cam[:3, 3] - a), axis=1)
    assert len(faces) > 1000 and np.all(towards > 0)


def test_blocks_meet_without_a_seam():
    size = (64, 48)
    camera = Camera(synthetic_views(1)[0])
    camera.world_from_cam = np.eye(4)
    volume = TsdfVolume(0.02)
    volume.add(camera, np.full(size[::-1], 1.01), np.ones(size[::-1]))
    assert len(volume._blocks) > 10
    mesh = trimesh.Trimesh(*volume.surface())
    mesh.merge_vertices()
    assert mesh.body_count == 1
    edges, count = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
    pixels, _ = project(camera, mesh.vertices[np.unique(edges[count == 1])])
    assert np.all(np.minimum(pixels, np.subtract(size, pixels)).min(axis=1) < 3)


def test_a_depth_map_seen_twice_changes_nothing():
    once, twice = box_room(2), box_room(2)
    for view in synthetic_views(2):
        twice.add(Camera(view), view.depth, np.ones_like(view.depth))
    np.testing.assert_allclose(once.surface()[0], twice.surface()[0], atol=1e-5)


def test_unknown_depth_makes_no_surface():
    view = synthetic_views(1)[0]
    volume = TsdfVolume(VOXEL)
    volume.add(Camera(view), np.zeros_like(view.depth), np.ones_like(view.depth))
    vertices, faces = volume.surface()
    assert vertices.shape == (0, 3) and faces.shape == (0, 3)


def test_voxels_must_have_a_size():
    with pytest.raises(InputError, match="must be positive"):
        TsdfVolume(0.0)


def test_every_voxel_within_the_truncation_of_a_depth_has_a_block():
    view = synthetic_views(1)[0]
    camera = Camera(view)
    volume = box_room(1)
    around = [back_project(camera, view.depth + off) for off in np.linspace(-0.19, 0.19, 9)]
    places = np.floor(np.concatenate(around).reshape(-1, 3) / (EDGE * VOXEL)).astype(int)
    assert {tuple(place) for place in places.tolist()} <= set(volume._blocks)


def test_blocks_keep_no_more_memory_than_their_own():
    assert all(block.base is None for block in box_room(2)._blocks.values())


def test_too_fine_voxels_are_refused_before_memory_is_short(monkeypatch):
    monkeypatch.setattr("mvsam.reconstruction.tsdf.MOST_BLOCKS", 20)
    with pytest.raises(InputError, match="choose larger voxels"):
        box_room(1)
