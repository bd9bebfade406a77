"""Photos' maps thinned by a whole-number step, and the cameras that fit them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int


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
        """Thinned values at the photo's (width, height): bilinear, and there where they belong."""
        if self.step == 1:
            return values
        (above, below, share), (left, right, part) = (
            self._between(count, length)
            for count, length in zip(values.shape, size[::-1], strict=True)
        )
        rows = values[above] * (1 - share)[:, None] + values[below] * share[:, None]
        return rows[:, left] * (1 - part) + rows[:, right] * part

    def _between(
        self, count: int, length: int
    ) -> tuple[Int[np.ndarray, " pixel"], Int[np.ndarray, " pixel"], Float32[np.ndarray, " pixel"]]:
        """Which two of `count` kept pixels each of `length` lies between, and how near the second.

        Beyond the first and the last kept pixel it is that one.
        """
        position = (np.arange(length) - self.step // 2) / self.step
        position = position.clip(0, count - 1)
        before = position.astype(np.int64)
        after = np.minimum(before + 1, count - 1)
        return before, after, (position - before).astype(np.float32)


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
