import numpy as np

from mvsam.reconstruction.filtering import back_project, neighbours, project, trusted
from tests.synthetic import BOX_MAX, BOX_MIN, SyntheticView, synthetic_views

SETTINGS = {
    "minimum_confidence": 0.5,
    "minimum_consistent_views": 1,
    "relative_tolerance": 0.02,
}


class Camera:
    def __init__(self, view: SyntheticView):
        self.size = (view.depth.shape[1], view.depth.shape[0])
        self.intrinsics, self.world_from_cam = view.intrinsics, view.world_from_cam


def distance_to_walls(points: np.ndarray) -> np.ndarray:
    return np.minimum(np.abs(points - BOX_MIN), np.abs(points - BOX_MAX)).min(axis=-1)


def test_true_depths_lie_on_the_walls():
    view = synthetic_views(1)[0]
    points = back_project(Camera(view), view.depth)
    assert distance_to_walls(points).max() < 1e-5


def test_projecting_undoes_back_projecting():
    view = synthetic_views(2)[1]
    pixels, depth = project(Camera(view), back_project(Camera(view), view.depth))
    columns, rows = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=-1), atol=1e-4)
    np.testing.assert_allclose(depth, view.depth, atol=1e-5)


def test_points_behind_a_camera_are_outside_its_picture():
    camera = Camera(synthetic_views(1)[0])
    behind = camera.world_from_cam[:3, 3] - camera.world_from_cam[:3, 2] + [[0.0, 0, 0]]
    pixels, depth = project(camera, behind)
    assert depth[0] < 0 and np.isinf(pixels).all()


def test_true_depths_are_trusted_wherever_another_photo_sees_them():
    first, second = synthetic_views(2)
    sure = np.ones_like(first.depth)
    others = [(Camera(second), second.depth)]
    keep = trusted(Camera(first), first.depth, sure, others, **SETTINGS)
    pixels, _ = project(Camera(second), back_project(Camera(first), first.depth))
    seen = np.all((pixels >= 0) & (pixels < (64, 48)), axis=-1)
    assert not keep[~seen].any()
    assert keep[seen].mean() > 0.97  # reading the nearest pixel misses some at the room's corners


def test_wrong_depths_are_not_trusted():
    first, second = synthetic_views(2)
    wrong = first.depth.copy()
    wrong[10:20, 30:40] *= 1.1
    others = [(Camera(second), second.depth)]
    keep = trusted(Camera(first), wrong, np.ones_like(wrong), others, **SETTINGS)
    assert not keep[10:20, 30:40].any()
    assert keep[30:40, 30:40].all()


def test_a_photo_with_wrong_depths_convinces_nobody():
    first, second, third = synthetic_views(3)
    others = [(Camera(second), second.depth * 1.2), (Camera(third), third.depth * 0.8)]
    keep = trusted(Camera(first), first.depth, np.ones_like(first.depth), others, **SETTINGS)
    assert keep.mean() < 0.02


def test_unknown_and_unsure_depths_are_not_trusted():
    first, second = synthetic_views(2)
    depth, confidence = first.depth.copy(), np.ones_like(first.depth)
    depth[:10] = 0
    confidence[10:20] = 0.4
    others = [(Camera(second), second.depth)]
    keep = trusted(Camera(first), depth, confidence, others, **SETTINGS)
    assert not keep[:20].any() and keep[20:].any()


def test_neighbours_are_those_that_see_the_same_points_best_first():
    views = synthetic_views(5)
    cameras = [Camera(view) for view in views]
    points = [back_project(Camera(view), view.depth)[::8, ::8].reshape(-1, 3) for view in views]
    assert neighbours(cameras, points, 0, 2) == [1, 2]
    turned = Camera(views[1])
    turned.world_from_cam = turned.world_from_cam @ np.diag([-1.0, 1, -1, 1])
    assert neighbours([cameras[0], turned], points[:2], 0, 2) == []


def test_a_photo_without_depth_has_no_neighbours():
    cameras = [Camera(view) for view in synthetic_views(2)]
    points = [np.empty((0, 3)), np.ones((4, 3))]
    assert neighbours(cameras, points, 0, most=3) == []
