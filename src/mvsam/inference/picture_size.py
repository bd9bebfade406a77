"""At which size a model sees photos."""

from collections.abc import Sequence

from mvsam.errors import InputError
from mvsam.types import Frame, Model

Size = tuple[int, int]
"""(width, height), pixels."""

SIDE_STEP = 32
"""Pixels; sides of pictures must be multiples of it."""
FINER = 1.5
"""Times `input_size`: later sweeps gain little by more (docs/log.md, 2026-11-29)."""


def picture_size(model: Model, frames: Sequence[Frame], asked: Size | None = None) -> Size:
    """The size asked for; else the model's own, `FINER` for `finer_sweeps` of photos as large.

    Raises `InputError` for sides that do not fit the network.
    """
    if asked is not None:
        check_size(asked)
        return asked
    finer = tuple(int(FINER * side) // SIDE_STEP * SIDE_STEP for side in model.input_size)
    are_larger = all(f.size[0] >= finer[0] and f.size[1] >= finer[1] for f in frames)
    return (finer[0], finer[1]) if model.finer_sweeps and are_larger else model.input_size


def check_size(size: Size) -> None:
    """Raises `InputError` for sides that are no multiples of `SIDE_STEP`."""
    if any(side <= 0 or side % SIDE_STEP for side in size):
        raise InputError(
            f"size {size[0]} {size[1]} does not fit the network: give a width and a height that "
            f"are multiples of {SIDE_STEP}, as 320 256."
        )
