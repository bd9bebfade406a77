"""One row a photo: the photo beside its maps, with the distances in it."""

from html import escape

import numpy as np
from jaxtyping import Float

from mvsam.apps.report.photos import Photo, read_depth, read_labels, read_map
from mvsam.apps.report.sections import lines
from mvsam.apps.report.thumbnails import (
    Thumbnail,
    confidence_thumbnail,
    depth_thumbnail,
    label_thumbnail,
    photo_thumbnail,
)
from mvsam.data.labels import ClassTable
from mvsam.inference.pictures import depth_limits


def photo_row(photo: Photo, classes: ClassTable) -> str:
    """What a photo has; maps of tasks that the model does not have are left out."""
    name, distances = photo.name, ""
    figures = [_figure(photo_thumbnail(photo.color_path), "Photo", name)]
    if photo.depth_path is not None:
        depth = read_depth(photo.depth_path)
        distances = f"\n<p>{_distances(depth)}</p>"
        figures.append(_figure(depth_thumbnail(depth), "Depth", name, _depth_scale(depth)))
    if photo.confidence_path is not None:
        picture = confidence_thumbnail(read_map(photo.confidence_path))
        figures.append(_figure(picture, "Confidence", name, _scale("confidence-scale", "0 ½ 1")))
    if photo.label_path is not None:
        picture = label_thumbnail(read_labels(photo.label_path), classes)
        figures.append(_figure(picture, "Labels", name))
    pictures = f'<div class="pictures">\n{lines(figures)}\n</div>'
    return f"<article>\n<h3>{escape(name)}</h3>{distances}\n{pictures}\n</article>"


def _distances(depth: Float[np.ndarray, "height width"]) -> str:
    known = depth[depth > 0]
    if not known.size:
        return "no depth known"
    near, middle, far = known.min(), np.median(known), known.max()
    return f"nearest {near:.2f} m, median {middle:.2f} m, farthest {far:.2f} m"


def _figure(picture: Thumbnail, title: str, name: str, scale: str = "") -> str:
    return (
        f'<figure><img src="{picture.address}" width="{picture.width}" height="{picture.height}" '
        f'loading="lazy" decoding="async" alt="{title} of {escape(name)}">'
        f"<figcaption>{title}{scale}</figcaption></figure>"
    )


def _depth_scale(depth: Float[np.ndarray, "height width"]) -> str:
    """Metres at the ends and the middle of the colours, which go by inverse depth."""
    if not np.any(depth > 0):
        return ""
    farthest, nearest = depth_limits(depth)
    metres = [1 / nearest, 2 / (nearest + farthest), 1 / farthest]
    return _scale("depth-scale", " ".join(f"{value:.2f}&nbsp;m" for value in metres))


def _scale(kind: str, marks: str) -> str:
    """A bar of colours over marks that are separated by blanks."""
    spans = "".join(f"<span>{mark}</span>" for mark in marks.split(" "))
    return f'<span class="{kind}"></span><span class="marks">{spans}</span>'
