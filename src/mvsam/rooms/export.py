"""Rooms written as posed folders, and contact sheets to look at."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from mvsam.types import Frame, Scene


def export_posed_folder(scene: Scene, folder: Path) -> None:
    """Write a posed folder: color, depth (16-bit mm), labels, poses, intrinsics.txt, views.txt.

    The calibration is written as OpenCV gives it, with integer pixel centres: our principal point
    minus 0.5.
    """
    for name in ("color", "depth", "labels", "poses"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    frames = [scene.frame(i) for i in range(len(scene))]
    opencv = frames[0].intrinsics.copy()
    opencv[:2, 2] -= 0.5
    np.savetxt(folder / "intrinsics.txt", opencv, fmt="%.9g")
    for frame in frames:
        _export_frame(frame, folder)
    lines = [" ".join(frames[i].name for i in view) for view in scene.views() or ()]
    (folder / "views.txt").write_text(
        "# reference, then sources, best first\n" + "\n".join(lines) + "\n"
    )


def _export_frame(frame: Frame, folder: Path) -> None:
    Image.fromarray(frame.image).save(folder / "color" / f"{frame.name}.png")
    np.savetxt(folder / "poses" / f"{frame.name}.txt", frame.world_from_cam, fmt="%.9g")
    if frame.depth is not None:
        millimetres = np.clip(np.rint(frame.depth * 1000), 0, 65535).astype(np.uint16)
        Image.fromarray(millimetres).save(folder / "depth" / f"{frame.name}.png")
    if frame.labels is not None:
        Image.fromarray(frame.labels).save(folder / "labels" / f"{frame.name}.png")


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
