"""A depth range that nobody has to give."""

from dataclasses import replace

import numpy as np
import pytest

from mvsam.data.depth_range import USUAL, estimate_depth_range
from mvsam.types import Frame


def frame_at(x: float, z: float) -> Frame:
    """Looks along +z."""
    pose = np.eye(4)
    pose[:3, 3] = (x, 0.0, z)
    intrinsics = np.array([[80.0, 0, 50], [0, 80, 40], [0, 0, 1]])
    return Frame("a", (100, 80), intrinsics, pose, load_image=lambda: np.zeros((80, 100, 3)))


def test_points_in_view_set_the_range_and_outliers_do_not():
    depths = np.linspace(2.0, 8.0, 400)
    points = np.stack([0 * depths, 0 * depths, depths], axis=1)
    far_off = np.array([[0, 0, 500.0], [100, 0, 3.0], [0, 0, -4.0]])
    near, far = estimate_depth_range([frame_at(0, 0)], np.concatenate([points, far_off]))
    assert near == pytest.approx(2.06 / 2.5, rel=0.02)
    assert far == pytest.approx(7.96 * 1.25, rel=0.02)


def test_too_few_points_say_nothing():
    assert estimate_depth_range([frame_at(0, 0)], np.array([[0, 0, 9.0]])) == USUAL


def test_without_points_the_range_reaches_as_far_as_cameras_are_seen():
    assert estimate_depth_range([frame_at(0, 0), frame_at(0.2, 0)]) == USUAL
    near, far = estimate_depth_range([frame_at(0, 0), frame_at(0.5, 8)])
    assert (near, far) == (0.1, pytest.approx(10.0))
    turned = replace(frame_at(0, 0), world_from_cam=np.diag([-1.0, 1, -1, 1]))
    assert estimate_depth_range([turned, frame_at(0.5, 8)]) == USUAL, "it is behind the camera"
