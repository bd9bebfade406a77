"""What people look at: depth as colours, and a photo beside its maps."""

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from mvsam.data.labels import ClassTable, colorize

PREVIEW_HEIGHT = 480
"""Previews are no higher than this, pixels."""

NEAR_TO_FAR = np.array(
    [
        [122, 4, 3],
        [213, 47, 15],
        [249, 127, 34],
        [236, 199, 58],
        [164, 236, 82],
        [58, 222, 155],
        [38, 171, 232],
        [70, 98, 216],
        [48, 18, 59],
    ],
    np.float64,
)
"""Colours at equal steps of inverse depth: red is near, blue is far."""


def depth_picture(
    depth: Float[np.ndarray, "height width"],
) -> UInt8[np.ndarray, "height width 3"]:
    """Colours for a depth map, spread over its own range of inverse depth; unknown is black.

    The nearest and farthest two percent share the end colours, so that outliers do not flatten
    the rest.
    """
    return depth_colors(depth, *depth_limits(depth))


def depth_limits(depth: Float[np.ndarray, "height width"]) -> tuple[float, float]:
    """(farthest, nearest) inverse depth, one a metre, without the outer two percent at each end."""
    known = depth[depth > 0]
    farthest, nearest = np.percentile(1 / known, (2, 98)) if known.size else (0.0, 1.0)
    return float(farthest), float(nearest)


def depth_colors(
    depth: Float[np.ndarray, "height width"], farthest: float, nearest: float
) -> UInt8[np.ndarray, "height width 3"]:
    """Colours between two inverse depths, those of the ends beyond them; unknown is black."""
    known = depth > 0
    inverse = 1 / np.where(known, depth, 1)
    position = (nearest - inverse) / max(nearest - farthest, 1e-9)
    stops = np.linspace(0, 1, len(NEAR_TO_FAR))
    channels = [np.interp(position, stops, channel) for channel in NEAR_TO_FAR.T]
    return np.where(known[..., None], np.stack(channels, axis=-1), 0).astype(np.uint8)


def preview(
    image: UInt8[np.ndarray, "height width 3"],
    depth: Float[np.ndarray, "height width"] | None,
    labels: UInt8[np.ndarray, "height width"] | None,
    classes: ClassTable,
) -> Image.Image:
    """The photo, its depth and its labels side by side; a missing map is left out."""
    step = -(-image.shape[0] // PREVIEW_HEIGHT)
    panels = [image[::step, ::step]]
    if depth is not None:
        panels.append(depth_picture(depth[::step, ::step]))
    if labels is not None:
        panels.append(_shaded(colorize(labels[::step, ::step], classes), panels[0]))
    return Image.fromarray(np.concatenate(panels, axis=1))


def _shaded(
    colors: UInt8[np.ndarray, "height width 3"], image: UInt8[np.ndarray, "height width 3"]
) -> UInt8[np.ndarray, "height width 3"]:
    """Class colours with some of the photo's light and shade, so that shapes stay readable."""
    brightness = image.astype(np.float32).mean(axis=-1, keepdims=True) / 255
    return (colors * (0.6 + 0.4 * brightness)).astype(np.uint8)
