"""Photos' maps thinned by a whole-number step, and the cameras that fit them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32
from PIL import Image


@dataclass(frozen=True)
class ThinnedCamera:
    """A posed photo of which every step-th pixel is kept."""

    size: tuple[int, int]
    """(width, height) of the thinned maps."""
    step: int
    """Every step-th pixel of the photo is kept."""
    intrinsics: Float[np.ndarray, "3 3"]
    """Pixels of the thinned maps, corner convention."""
    world_from_cam: Float[np.ndarray, "4 4"]
    """Metres, OpenCV axes."""

    def thinned(self, pixels: np.ndarray) -> np.ndarray:
        """The middle pixel of each step x step block; its centre is the block's for odd steps.

        A copy, so that the whole picture need not be kept.
        """
        (width, height), first = self.size, self.step // 2
        return pixels[first :: self.step, first :: self.step][:height, :width].copy()

    def enlarged(
        self, values: Float32[np.ndarray, "_ _"], size: tuple[int, int]
    ) -> Float32[np.ndarray, "height width"]:
        """Thinned values at the photo's (width, height): bilinear, and there where they belong.

        Beyond the outermost kept pixels all is as there.
        """
        if self.step == 1:
            return values
        width, height = size
        corner = 1.5 - (self.step // 2 + 0.5) / self.step  # the photo's, one pixel of edge around
        box = (corner, corner, corner + width / self.step, corner + height / self.step)
        picture = Image.fromarray(np.pad(values, 1, mode="edge"))
        return np.asarray(picture.resize(size, Image.Resampling.BILINEAR, box))


def thin(
    size: tuple[int, int],
    intrinsics: Float[np.ndarray, "3 3"],
    world_from_cam: Float[np.ndarray, "4 4"],
    longest_side: int,
) -> ThinnedCamera:
    """A photo of this size by the smallest step with which no side is longer than that."""
    width, height = size
    step = -(-max(width, height) // longest_side)
    intrinsics = intrinsics / [[step], [step], [1]]
    # The kept pixel's centre (step // 2 + 0.5) must land on (0.5, 0.5) of the thinned map.
    intrinsics[:2, 2] += 0.5 - (step // 2 + 0.5) / step
    thinned_size = (max(width // step, 1), max(height // step, 1))
    return ThinnedCamera(thinned_size, step, intrinsics, world_from_cam)
