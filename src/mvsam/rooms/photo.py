"""What a camera makes of the light: lens, shutter, sensor, and the pictures a phone makes of it.

`Sensor` is the camera of a whole scene; every frame then has its own exposure, blur and noise.
"""

import io
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from .dice import Dice

Light = Float[np.ndarray, "height width 3"]
"""Linear light."""
_METERED = 0.38
"""Where a light meter brings the typical surface to, linear light."""


@dataclass(frozen=True)
class Sensor:
    """A camera's habits, from a Kinect's noise to a phone's sharpened and compressed pictures."""

    cast: tuple[float, float, float]
    """Factor of each channel that the white balance leaves behind."""
    vignette: float
    """Loss of light in the corners, 0..1."""
    noise: float
    """1: at 8 bits about one level in mid-grey."""
    blotches: float
    """Share of the noise that spreads over several pixels, as after denoising or scaling."""
    softness: float
    """Weight of the neighbours on each side in a blur of the lens, 0..0.2."""
    sharpening: float
    """0..1."""
    saturation: float
    contrast: float
    """Steepness of the tone curve, 1: as the display expects."""
    metering: float
    """0: one exposure for the scene; 1: every frame's typical light is brought to mid-grey."""
    shake: float
    """Typical length of the smear of a moving camera, in thousandths of the picture's width."""
    shear: float
    """Spread of the shift between first and last row, thousandths of the width: rolling shutter."""
    quality: int
    """Of the JPEG, 0: none."""

    @staticmethod
    def draw(dice: Dice) -> "Sensor":
        """About a third are clean, the others have some fault each."""
        is_clean = dice.chance(0.3)
        strength, warmth = 0.3 if is_clean else 1.0, dice.uniform(-0.22, 0.22)
        return Sensor(
            cast=(1 + warmth, dice.uniform(0.95, 1.05), 1 - warmth),
            vignette=dice.uniform(0.02, 0.22),
            noise=strength * 0.4 * 9.0 ** dice.uniform(),
            blotches=dice.uniform(0.0, 0.8),
            softness=dice.uniform(0.0, 0.17),
            sharpening=dice.uniform(0.2, 0.8) if dice.chance(0.35) else 0.0,
            saturation=dice.uniform(0.6, 1.12),
            contrast=dice.uniform(0.85, 1.3),
            metering=dice.uniform(0.3, 0.9) if dice.chance(0.6) else 0.0,
            shake=0.0 if is_clean else dice.uniform(0.0, 6.0),
            shear=dice.uniform(0.0, 2.0) if dice.chance(0.25) else 0.0,
            quality=dice.count(45, 95) if dice.chance(0.7) else 0,
        )

    def develop(
        self, radiance: Light, exposure: float, dice: Dice
    ) -> UInt8[np.ndarray, "height width 3"]:
        """An 8-bit RGB photograph; `exposure` is the scene's, varied for each frame."""
        light = radiance * self._gain(radiance * np.float32(exposure), dice) * np.float32(exposure)
        light *= _vignette(light.shape[:2], self.vignette)[..., None]
        light = self._moved(light, dice)
        if self.softness > 0.02:
            light = _soften(light, self.softness)
        display = _tone(np.maximum(light + self._noise(light, dice), 0), self.contrast)
        display = self._finished(display)
        pixels = (np.clip(display, 0, 1) * 255 + 0.5).astype(np.uint8)
        return _compressed(pixels, self.quality) if self.quality else pixels

    def _gain(self, light: Light, dice: Dice) -> np.ndarray:
        """Factor of each channel: the meter follows the frame, the white balance wanders."""
        balance = np.array([c * dice.uniform(0.97, 1.03) for c in self.cast], dtype=np.float32)
        typical = float(np.exp(np.log(light[::4, ::4].mean(axis=2) + 1e-3).mean()))
        followed = np.clip((_METERED / typical) ** self.metering, 0.5, 2.0)
        return balance * np.float32(followed * dice.uniform(0.92, 1.08))

    def _moved(self, light: Light, dice: Dice) -> Light:
        """Smeared along one direction, rows sheared by a rolling shutter; the middle row stays."""
        width = light.shape[1]
        length = self.shake * dice.uniform() ** 3 * width / 1000
        turn, shear = dice.uniform(0, np.pi), self.shear * dice.uniform(-1, 1) * width / 1000
        if length > 0.4:
            step = 0.5 * length * np.array([np.cos(turn), np.sin(turn)])
            parts = [_shifted(light, *(share * step)) for share in (-1, -0.5, 0.5, 1)]
            light = (light + sum(parts)) / np.float32(1 + len(parts))
        return _sheared(light, shear) if abs(shear) > 0.3 else light

    def _noise(self, light: Light, dice: Dice) -> Light:
        """Of the photons and of the electronics, linear light."""
        grain = dice.normal(*light.shape)
        if self.blotches > 0.1:
            spread = _soften(_soften(grain, 0.25), 0.25) * np.float32(2.2)
            grain = (1 - self.blotches) * grain + self.blotches * spread
        return np.sqrt(np.float32(self.noise**2) * (1e-5 + 2e-4 * light)) * grain

    def _finished(self, display: Light) -> Light:
        """Sharpened and coloured as cameras do by themselves."""
        if self.sharpening:
            display = display + np.float32(self.sharpening) * (display - _soften(display, 0.25))
        grey = display.mean(axis=2, keepdims=True)
        return grey + np.float32(self.saturation) * (display - grey)


def _tone(light: Light, contrast: float) -> Light:
    """Linear light to display values: a soft shoulder, the display gamma, a steeper middle."""
    shoulder = light * (1 + light * 0.25) / (1 + light)
    return (2 * shoulder) ** np.float32(contrast / 2.2) * np.float32(0.5 ** (1 / 2.2))


def _vignette(shape: tuple[int, int], strength: float) -> np.ndarray:
    rows = np.linspace(-1, 1, shape[0], dtype=np.float32)[:, None]
    columns = np.linspace(-1, 1, shape[1], dtype=np.float32)[None, :]
    return 1 - np.float32(strength / 2) * (rows**2 + columns**2)


def _soften(light: Light, side: float) -> Light:
    """A 3 x 3 blur with weights (side, 1 - 2 side, side) each way."""
    padded = np.pad(light, ((1, 1), (1, 1), (0, 0)), mode="edge")
    middle, beside = np.float32(1 - 2 * side), np.float32(side)
    padded = middle * padded[:, 1:-1] + beside * (padded[:, :-2] + padded[:, 2:])
    return middle * padded[1:-1] + beside * (padded[:-2] + padded[2:])


def _shifted(light: Light, right: float, down: float) -> Light:
    """Moved by fractions of a pixel, bilinearly; edges repeat."""
    height, width = light.shape[:2]
    rows, columns = np.arange(height) - down, np.arange(width) - right
    return _between(_between(light, rows, 0), columns, 1)


def _between(light: Light, places: np.ndarray, axis: int) -> Light:
    """Values at fractional places along an axis."""
    last = light.shape[axis] - 1
    places = np.clip(places, 0, last)
    low = np.minimum(places.astype(np.int32), max(last - 1, 0))
    part = (places - low).astype(np.float32).reshape([-1, 1, 1] if axis == 0 else [1, -1, 1])
    return light.take(low, axis) * (1 - part) + light.take(np.minimum(low + 1, last), axis) * part


def _sheared(light: Light, shift: float) -> Light:
    """Rows moved right in proportion to their height, `shift` pixels from first to last."""
    height, width = light.shape[:2]
    places = np.arange(width) - shift * (np.arange(height)[:, None] / (height - 1) - 0.5)
    places = np.clip(places, 0, width - 1)
    low = np.minimum(places.astype(np.int32), width - 2)
    part, row = (places - low).astype(np.float32)[..., None], np.arange(height)[:, None]
    return light[row, low] * (1 - part) + light[row, low + 1] * part


def _compressed(pixels: UInt8[np.ndarray, "height width 3"], quality: int) -> np.ndarray:
    """What is left after JPEG; the library may change a level between its versions."""
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=quality)
    return np.array(Image.open(file))
