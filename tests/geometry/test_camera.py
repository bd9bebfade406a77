import numpy as np
import torch

from mvsam.geometry.camera import (
    invert_intrinsics,
    pixel_centres,
    scale_intrinsics,
)
from tests.reference.plane_sweep import project
from tests.small import random_views


def test_the_first_pixel_centre_lies_half_a_pixel_from_the_corner():
    centres = pixel_centres(2, 3)
    assert centres[0, 0].tolist() == [0.5, 0.5, 1.0]
    assert centres[1, 2].tolist() == [2.5, 1.5, 1.0]


def test_resize_then_project_equals_project_then_resize():
    views = random_views(height=32, width=48, seed=1)
    scaled = scale_intrinsics(views.intrinsics, 0.25, 0.5)[0].double().numpy()
    intrinsics, poses = views.intrinsics[0].double().numpy(), views.world_from_cam[0].numpy()
    for u, v, depth in [(10.5, 3.25, 1.3), (40.0, 31.5, 4.0)]:
        full, z = project((u, v), depth, intrinsics, poses, source=2)
        small, small_z = project((u / 4, v / 2), depth, scaled, poses, source=2)
        np.testing.assert_allclose(small, full * [0.25, 0.5], atol=1e-9)
        assert abs(z - small_z) < 1e-9


def test_inverse_intrinsics_undo_any_calibration():
    skewed = torch.tensor([[290.0, 3.0, 160.0], [0.0, 310.0, 128.0], [0.0, 0.0, 1.0]])
    intrinsics = torch.stack([skewed, torch.diag(torch.tensor([2.0, 4.0, 1.0]))]).double()
    product = invert_intrinsics(intrinsics) @ intrinsics
    torch.testing.assert_close(product, torch.eye(3).double().expand(2, 3, 3))
