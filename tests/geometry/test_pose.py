import torch

from mvsam.geometry.pose import invert
from tests.small import random_poses


def test_inverse_of_a_rigid_motion_undoes_it():
    poses = random_poses(5, torch.Generator().manual_seed(0)).double()
    # The rotations were made in float32, so they are orthogonal to its precision only.
    torch.testing.assert_close(invert(poses), torch.linalg.inv(poses), atol=1e-6, rtol=0)
