"""What a hand-held camera makes of the light: exposure, white balance, vignette, noise, 8 bits."""

import numpy as np
from jaxtyping import Float, UInt8

from .dice import Dice


def develop(
    radiance: Float[np.ndarray, "height width 3"], exposure: float, dice: Dice
) -> UInt8[np.ndarray, "height width 3"]:
    """An 8-bit RGB photograph; `exposure` is the scene's, varied a little for each frame."""
    balance = np.array([dice.uniform(0.96, 1.04) for _ in range(3)], dtype=np.float32)
    light = radiance * (exposure * dice.uniform(0.9, 1.1) * balance)
    light *= _vignette(light.shape[:2], dice.uniform(0.02, 0.18))[..., None]
    if dice.chance(0.5):
        light = _soften(light, dice.uniform(0.03, 0.16))
    deviation = np.sqrt(np.float32(dice.uniform(0.2, 1.0)) * (1e-5 + 4e-4 * light))
    light = light + deviation * dice.normal(*light.shape)
    display = _tone(np.maximum(light, 0))
    return (np.clip(display, 0, 1) * 255 + 0.5).astype(np.uint8)


def _tone(light: np.ndarray) -> np.ndarray:
    """Linear light to display values: a soft shoulder, then the display gamma."""
    return (light * (1 + light * 0.25) / (1 + light)) ** np.float32(1 / 2.2)


def _vignette(shape: tuple[int, int], strength: float) -> np.ndarray:
    rows = np.linspace(-1, 1, shape[0], dtype=np.float32)[:, None]
    columns = np.linspace(-1, 1, shape[1], dtype=np.float32)[None, :]
    return 1 - np.float32(strength / 2) * (rows**2 + columns**2)


def _soften(light: np.ndarray, side: float) -> np.ndarray:
    """A 3 x 3 blur with weights (side, 1 - 2 side, side) each way."""
    for axis in (0, 1):
        before = np.concatenate(
            [light.take([0], axis), light.take(range(light.shape[axis] - 1), axis)], axis
        )
        after = np.concatenate(
            [light.take(range(1, light.shape[axis]), axis), light.take([-1], axis)], axis
        )
        light = (1 - 2 * side) * light + side * (before + after)
    return light
