import numpy as np
import torch

from mvsam.geometry.pose import cross_matrix, invert, moved_by, pose_from_rotation_vector
from tests.small import random_poses


def test_inverse_of_a_rigid_motion_undoes_it():
    poses = random_poses(5, torch.Generator().manual_seed(0)).double()
    # The rotations were made in float32, so they are orthogonal to its precision only.
    torch.testing.assert_close(invert(poses), torch.linalg.inv(poses), atol=1e-6, rtol=0)


def test_a_cross_matrix_multiplies_crosswise():
    a, b = torch.randn(2, 7, 3, generator=torch.Generator().manual_seed(1))
    product = (cross_matrix(a) @ b[..., None])[..., 0]
    torch.testing.assert_close(product, torch.linalg.cross(a, b))


def test_cameras_step_in_their_own_axes():
    dice = torch.Generator().manual_seed(2)
    poses = random_poses(4, dice).double()
    steps = torch.randn(4, 6, generator=dice, dtype=torch.float64)
    for pose, step, found in zip(poses, steps, moved_by(poses, steps), strict=True):
        motion = pose_from_rotation_vector(step[:3].numpy(), step[3:].numpy())
        np.testing.assert_allclose(found, pose.numpy() @ motion, atol=1e-12)
