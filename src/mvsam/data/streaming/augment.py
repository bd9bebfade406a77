"""Training views that differ from the recorded ones, with cameras that still fit them."""

from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from mvsam.data.transforms import crop_to_window
from mvsam.geometry.pose import pose_from_rotation_vector
from mvsam.types import Frame

_MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


def mirrored(frame: Frame) -> Frame:
    """The frame as seen in a mirror world: left and right swapped, geometry exact.

    With S = diag(-1, 1, 1, 1) the world becomes S X and the camera S T S, which is rigid again.
    Mirror all views of a tuple or none.
    """
    intrinsics = frame.intrinsics.copy()
    intrinsics[0, 1:] = -intrinsics[0, 1], frame.size[0] - intrinsics[0, 2]
    load_depth, load_labels = frame.load_depth, frame.load_labels
    return replace(
        frame,
        intrinsics=intrinsics,
        world_from_cam=_MIRROR @ frame.world_from_cam @ _MIRROR,
        load_image=lambda: _flipped(frame.load_image()),
        load_depth=None if load_depth is None else lambda: _flipped(load_depth()),
        load_labels=None if load_labels is None else lambda: _flipped(load_labels()),
    )


def random_part(frame: Frame, smallest: float, dice: np.random.Generator) -> Frame:
    """A window of the frame anywhere in it, of its shape, as large as chance says.

    smallest: of the window's sides, as a share of the frame's; 1 is the whole frame. Depth stays as
    it is, as if the lens were longer.
    """
    share, across, down = dice.uniform(smallest, 1), dice.random(), dice.random()
    width, height = (round(share * side) for side in frame.size)
    corner = round(across * (frame.size[0] - width)), round(down * (frame.size[1] - height))
    return crop_to_window(frame, corner, (width, height))


def with_pose_noise(
    frame: Frame, metres: float, degrees: float, dice: np.random.Generator
) -> Frame:
    """The frame with the pose that a tracker might have found for it.

    metres, degrees: standard deviations along and about each of the camera's axes.
    """
    rotation = np.radians(degrees) * dice.standard_normal(3)
    error = pose_from_rotation_vector(rotation, metres * dice.standard_normal(3))
    return replace(frame, world_from_cam=frame.world_from_cam @ error)


def _flipped(pixels: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(pixels[:, ::-1])


def jitter_colors(
    images: Float[Tensor, "view 3 height width"], strength: float, dice: np.random.Generator
) -> Float[Tensor, "view 3 height width"]:
    """Another exposure, white balance, contrast and gamma for each view; RGB in [0, 1].

    strength: standard deviation of the logarithm of the gain; 0 changes nothing. Half of it is
    shared by the views, as light is; the rest is each view's own, as automatic exposure is.
    """
    count = len(images)

    def spread(scale: float, *shape: int) -> Tensor:
        shared, own = dice.standard_normal((1, *shape)), dice.standard_normal((count, *shape))
        return torch.from_numpy(strength * scale * (shared + own) / 2**0.5).float()

    gain = torch.exp(spread(1.0, 1, 1, 1) + spread(0.3, 3, 1, 1))
    gamma = torch.exp(spread(0.7, 1, 1, 1))
    contrast = torch.exp(spread(0.7, 1, 1, 1))
    curved = (images * gain).clamp(0, 1) ** gamma
    middle = curved.mean(dim=(1, 2, 3), keepdim=True)
    return (middle + contrast * (curved - middle)).clamp(0, 1)


def as_if_estimated(
    depth: Float[Tensor, "1 height width"], spread: float, dice: np.random.Generator
) -> Float[Tensor, "1 height width"]:
    """Measured depth with a plane sweep's faults: washed-out edges, slow errors; 0 = unknown.

    spread: standard deviation of the errors' logarithm; the edges lose 4 to 24 pixels.
    """
    height, width = depth.shape[-2:]
    cell = int(dice.integers(4, 25))
    known = (depth[None] > 0).to(depth.dtype)
    coarse = (max(height // cell, 1), max(width // cell, 1))
    # Both are smoothed before one is divided by the other: a cell without depth has no say.
    sums, shares = (
        F.interpolate(F.interpolate(x, coarse, mode="area"), (height, width), mode="bilinear")
        for x in (depth[None], known)
    )
    blurred = sums / shares.clamp(min=1e-6)
    errors = torch.from_numpy(dice.normal(0, spread, (1, 1, 5, 6)).astype(np.float32))
    slow = F.interpolate(errors, (height, width), mode="bicubic")
    return torch.where(known > 0, blurred * slow.exp(), 0)[0]
