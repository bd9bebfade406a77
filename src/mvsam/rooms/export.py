"""Rooms written as posed folders, and contact sheets to look at."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from mvsam.files import write_whole
from mvsam.geometry.depth_map import to_millimetres
from mvsam.types import Frame, Scene


def export_posed_folder(scene: Scene, folder: Path) -> None:
    """Write a posed folder: color, depth (16-bit mm), labels, poses, intrinsics.txt, views.txt.

    The calibration is written as OpenCV gives it, with integer pixel centres: our principal point
    minus 0.5.
    """
    frames = [scene.frame(i) for i in range(len(scene))]
    opencv = frames[0].intrinsics.copy()
    opencv[:2, 2] -= 0.5
    _write_matrix(folder / "intrinsics.txt", opencv)
    for frame in frames:
        _export_frame(frame, folder)
    lines = [" ".join(frames[i].name for i in view) for view in scene.views() or ()]
    text = "\n".join(["# reference, then sources, best first", *lines, ""])
    write_whole(folder / "views.txt", lambda file: file.write(text.encode()))


def _export_frame(frame: Frame, folder: Path) -> None:
    _write_png(folder / "color" / f"{frame.name}.png", frame.image)
    _write_matrix(folder / "poses" / f"{frame.name}.txt", frame.world_from_cam)
    if (depth := frame.depth) is not None:
        _write_png(folder / "depth" / f"{frame.name}.png", to_millimetres(depth))
    if (labels := frame.labels) is not None:
        _write_png(folder / "labels" / f"{frame.name}.png", labels)


def _write_png(path: Path, pixels: np.ndarray) -> None:
    write_whole(path, lambda file: Image.fromarray(pixels).save(file, format="PNG"))


def _write_matrix(path: Path, matrix: np.ndarray) -> None:
    write_whole(path, lambda file: np.savetxt(file, matrix, fmt="%.9g"))


def preview_sheet(
    scenes: Sequence[Scene],
    palette: UInt8[np.ndarray, "num_classes 3"],
    frame: int = 0,
    max_depth: float = 5.0,
) -> Image.Image:
    """One row a scene: photograph, depth (near is warm, `max_depth` metres is dark), labels."""
    rows = [_preview_row(scene.frame(frame), palette, max_depth) for scene in scenes]
    return Image.fromarray(np.concatenate(rows, axis=0))


def _preview_row(frame: Frame, palette: np.ndarray, max_depth: float) -> np.ndarray:
    colors = np.zeros((256, 3), dtype=np.uint8)
    colors[: len(palette)] = palette
    image, depth, labels = frame.image, frame.depth, frame.labels
    assert depth is not None and labels is not None
    return np.concatenate([image, _depth_colors(depth, max_depth), colors[labels]], axis=1)


def _depth_colors(depth: np.ndarray, max_depth: float) -> np.ndarray:
    stops = np.array(
        [[240, 249, 33], [248, 149, 64], [204, 71, 120], [126, 3, 168], [13, 8, 135]], dtype=float
    )
    place = np.clip(depth / max_depth, 0, 1) * (len(stops) - 1)
    channels = [np.interp(place, np.arange(len(stops)), stops[:, c]) for c in range(3)]
    return np.stack(channels, axis=-1).astype(np.uint8)
