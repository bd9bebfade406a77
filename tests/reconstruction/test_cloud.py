import numpy as np
import pytest

from mvsam.errors import InputError
from mvsam.reconstruction.cloud import PointCloud, VoxelGrid
from mvsam.reconstruction.settings import CloudSettings
from mvsam.types import IGNORE


def cloud(points, colors=None, labels=None, confidence=None) -> PointCloud:
    points = np.array(points, np.float32)
    count = len(points)
    return PointCloud(
        points,
        np.array(colors if colors is not None else np.zeros((count, 3)), np.uint8),
        np.array(labels if labels is not None else np.zeros(count), np.uint8),
        np.array(confidence if confidence is not None else np.ones(count), np.float32),
    )


def test_a_voxel_keeps_means_and_the_majority_label():
    grid = VoxelGrid(0.1)
    points = [[0.01, 0.02, 0.03], [0.03, 0.04, 0.05], [0.05, 0.06, 0.07]]
    grid.add(cloud(points, [[0, 30, 90], [30, 30, 90], [60, 30, 90]], [4, 7, 7], [0.2, 0.4, 0.6]))
    merged = grid.cloud()
    np.testing.assert_allclose(merged.points, [[0.03, 0.04, 0.05]], atol=1e-6)
    np.testing.assert_array_equal(merged.colors, [[30, 30, 90]])
    np.testing.assert_array_equal(merged.labels, [7])
    np.testing.assert_allclose(merged.confidence, [0.4], atol=1e-6)


def test_points_of_different_voxels_stay_apart_also_below_zero():
    grid = VoxelGrid(0.1)
    grid.add(cloud([[0.01, 0, 0], [-0.01, 0, 0], [0.01, 0.11, 0], [0.01, 0, -0.01]]))
    assert len(grid.cloud()) == 4


def test_adding_in_parts_equals_adding_at_once():
    random = np.random.default_rng(0)
    points = random.uniform(-0.3, 0.3, (500, 3))
    labels = random.choice([0, 3, IGNORE], 500)
    colors = random.integers(0, 256, (500, 3))
    at_once, in_parts = VoxelGrid(0.1), VoxelGrid(0.1)
    at_once.add(cloud(points, colors, labels))
    for part in np.array_split(np.arange(500), 7):
        in_parts.add(cloud(points[part], colors[part], labels[part]))
        in_parts._compact()
    one, other = at_once.cloud(), in_parts.cloud()
    np.testing.assert_allclose(one.points, other.points, atol=1e-6)
    np.testing.assert_array_equal(one.labels, other.labels)
    # A mean of exactly x.5 may round either way after sums in another order.
    np.testing.assert_allclose(one.colors, other.colors.astype(float), atol=1)


def test_any_label_wins_against_none():
    grid = VoxelGrid(0.1)
    grid.add(cloud([[0.01] * 3] * 4, labels=[IGNORE, IGNORE, 5, IGNORE]))
    grid.add(cloud([[0.21] * 3] * 2, labels=[IGNORE, IGNORE]))
    np.testing.assert_array_equal(grid.cloud().labels, [5, IGNORE])


def test_a_voxel_size_must_suit_the_scene():
    with pytest.raises(InputError, match="must be positive"):
        VoxelGrid(0.0)
    with pytest.raises(InputError, match="choose larger voxels"):
        VoxelGrid(1e-4).add(cloud([[20.0, 0, 0]]))


def test_an_empty_grid_is_an_empty_cloud():
    assert len(VoxelGrid(CloudSettings().voxel_size).cloud()) == 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"voxel_size": 0.0},
        {"voxel_size": float("inf")},
        {"minimum_confidence": 20.0},
        {"relative_tolerance": -1.0},
        {"neighbours": -1},
        {"minimum_consistent_views": -1},
    ],
)
def test_settings_out_of_range_are_named(wrong: dict):
    (name,) = wrong
    with pytest.raises(InputError, match="--" + name.replace("_", "-")):
        CloudSettings(**wrong)
