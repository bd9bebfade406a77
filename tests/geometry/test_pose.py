import torch

from mvsam.geometry.pose import invert, transform
from tests.small import random_poses


def test_inverse_of_a_rigid_motion_undoes_it():
    poses = random_poses(5, torch.Generator().manual_seed(0)).double()
    # The rotations were made in float32, so they are orthogonal to its precision only.
    torch.testing.assert_close(invert(poses), torch.linalg.inv(poses), atol=1e-6, rtol=0)


def test_transform_rotates_before_it_moves():
    quarter_turn = torch.tensor([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    point = torch.tensor([1.0, 0.0, 0.0]).expand(1, 1, 3)
    assert transform(quarter_turn, point).flatten().tolist() == [1.0, 3.0, 3.0]
