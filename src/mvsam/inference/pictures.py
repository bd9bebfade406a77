"""What people look at: depth as colours, and a photo beside its maps."""

from functools import cache

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image, ImageDraw, ImageFont

from mvsam.data.labels import ClassTable, colorize

PREVIEW_HEIGHT = 480
"""The pictures of a preview are no higher than this, pixels."""

LEGEND_HEIGHT = 18
"""Of the strip below the maps of a preview that says what their colours mean, pixels."""

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
    known = depth[(depth > 0) & np.isfinite(depth)]
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
    """The photo, its depth and its labels side by side, with a legend; a missing map is left out.

    Below the depth stand the metres of its nearest and farthest colour, below the labels the names
    of the classes that cover most, as many as fit.
    """
    step = -(-image.shape[0] // PREVIEW_HEIGHT)
    panels = [image[::step, ::step]]
    height, width = panels[0].shape[:2]
    legends = [_strip(width)]
    if depth is not None:
        shown = depth[::step, ::step]
        panels.append(depth_picture(shown))
        legends.append(_depth_legend(width, shown))
    if labels is not None:
        shown = labels[::step, ::step]
        panels.append(_shaded(colorize(shown, classes), panels[0]))
        legends.append(_class_legend(width, shown, classes))
    picture = Image.new("RGB", (width * len(panels), height + LEGEND_HEIGHT))
    for index, (panel, legend) in enumerate(zip(panels, legends, strict=True)):
        picture.paste(Image.fromarray(panel), (width * index, 0))
        picture.paste(legend, (width * index, height))
    return picture


def _depth_legend(width: int, depth: Float[np.ndarray, "height width"]) -> Image.Image:
    """Metres at the near end, the colours, metres at the far end.

    Empty where no depth is known or there is no room.
    """
    legend, font = _strip(width), _font()
    farthest, nearest = depth_limits(depth)
    if farthest <= 0:
        return legend
    near, far = (f"{1 / end:.2f} m" for end in (nearest, farthest))
    begin, end = (round(font.getlength(text)) + 8 for text in (near, far))
    length = width - begin - end
    if length < 1:
        return legend
    draw = ImageDraw.Draw(legend)
    draw.text((4, LEGEND_HEIGHT / 2), near, "black", font, anchor="lm")
    draw.text((width - 4, LEGEND_HEIGHT / 2), far, "black", font, anchor="rm")
    ramp = 1 / np.linspace(nearest, farthest, length)
    bar = depth_colors(np.tile(ramp, (LEGEND_HEIGHT - 8, 1)), farthest, nearest)
    legend.paste(Image.fromarray(bar), (begin, 4))
    return legend


def _class_legend(
    width: int, labels: UInt8[np.ndarray, "height width"], classes: ClassTable
) -> Image.Image:
    """A patch of its colour and the name of each class, largest first, while there is room."""
    legend, font, x = _strip(width), _font(), 4
    draw = ImageDraw.Draw(legend)
    counts = np.bincount(labels.ravel(), minlength=len(classes))[: len(classes)]
    for index in np.argsort(-counts, kind="stable")[: np.count_nonzero(counts)]:
        name = classes.names[index]
        end = x + 12 + round(font.getlength(name))
        if end > width:
            break
        draw.rectangle((x, 5, x + 8, LEGEND_HEIGHT - 6), fill=classes.colors[index])
        draw.text((x + 12, LEGEND_HEIGHT / 2), name, "black", font, anchor="lm")
        x = end + 8
    return legend


def _strip(width: int) -> Image.Image:
    return Image.new("RGB", (width, LEGEND_HEIGHT), "white")


@cache
def _font() -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size=11)
    assert isinstance(font, ImageFont.FreeTypeFont)  # as of any size since Pillow 10.1
    return font


def _shaded(
    colors: UInt8[np.ndarray, "height width 3"], image: UInt8[np.ndarray, "height width 3"]
) -> UInt8[np.ndarray, "height width 3"]:
    """Class colours with some of the photo's light and shade, so that shapes stay readable."""
    brightness = image.astype(np.float32).mean(axis=-1, keepdims=True) / 255
    return (colors * (0.6 + 0.4 * brightness)).astype(np.uint8)
