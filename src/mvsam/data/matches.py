"""Features that pairs of photos share, matched by COLMAP."""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from mvsam.data.readers.colmap import import_pycolmap
from mvsam.data.transforms import resize_intrinsics
from mvsam.errors import InputError
from mvsam.geometry.epipolar import Matches
from mvsam.types import Frame

WIDTH = 640
"""A right match is taken to be off by a pixel, in larger photos by a pixel of this width."""
FEWEST_MATCHES = 15
"""Of a pair; fewer may be chance."""
MATCHES_PER_PAIR = 100
"""Evenly drawn; more add time alone."""
LARGEST_SIDE = 960
"""Pixels of the photos that features are sought in; larger ones are reduced, which saves seconds
and costs less than the pixel of `WIDTH` by which matches are judged."""


def pixel_size(frames: Sequence[Frame]) -> float:
    """At z = 1, the median of the photos: what the distance of a right match is measured by."""
    return float(np.median([max(1.0, max(f.size) / WIDTH) / f.intrinsics[0, 0] for f in frames]))


def match_photos(name: str, frames: Sequence[Frame]) -> list[Matches]:
    """Of all pairs with `FEWEST_MATCHES` or more; cameras' places and turns play no part.

    `name` is for messages. Raises `MissingExtraError` without the extra `colmap`, and InputError
    where COLMAP fails.
    """
    pycolmap = import_pycolmap("corrected poses")
    pycolmap.logging.minloglevel = 2  # errors only
    frames = [_reduced(frame) for frame in frames]
    with tempfile.TemporaryDirectory() as folder:
        database = Path(folder) / "database.db"
        files = [Path(folder) / f"{index:06d}.png" for index in range(len(frames))]
        for file, frame in zip(files, frames, strict=True):
            Image.fromarray(frame.image).save(file, compress_level=1)
        try:
            return _matched_pairs(pycolmap, database, files, frames)
        except Exception as error:  # pycolmap raises many kinds
            raise InputError(f"{name}: COLMAP cannot match its photos ({error}).") from error


def _reduced(frame: Frame) -> Frame:
    """With a photo of `LARGEST_SIDE` at most, read when asked for, and its intrinsics."""
    ratio = LARGEST_SIDE / max(frame.size)
    if ratio >= 1:
        return frame
    size = (max(1, round(ratio * frame.size[0])), max(1, round(ratio * frame.size[1])))

    def load() -> np.ndarray:
        return np.asarray(Image.fromarray(frame.image).resize(size, Image.Resampling.BOX))

    intrinsics = resize_intrinsics(frame.intrinsics, frame.size, size)
    return replace(frame, size=size, intrinsics=intrinsics, load_image=load)


def _matched_pairs(
    pycolmap: Any, database: Path, files: Sequence[Path], frames: Sequence[Frame]
) -> list[Matches]:
    names = [file.name for file in files]
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads = 1  # else photos are numbered as they get ready, and matched so
    pycolmap.extract_features(
        database,
        files[0].parent,
        image_names=names,
        camera_mode=pycolmap.CameraMode.PER_IMAGE,
        extraction_options=extraction,
    )
    with pycolmap.Database.open(database) as opened:
        images = [opened.read_image_with_name(name) for name in names]
        for image, frame in zip(images, frames, strict=True):
            opened.update_camera(_camera(pycolmap, frame, image.camera_id))
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = 0
    pycolmap.match_exhaustive(database, verification_options=verification)
    with pycolmap.Database.open(database) as opened:
        rays = [
            _rays(opened.read_keypoints(image.image_id)[:, :2], frame.intrinsics)
            for image, frame in zip(images, frames, strict=True)
        ]
        pair_ids, geometries = opened.read_two_view_geometries()
    numbers = {image.image_id: index for index, image in enumerate(images)}
    # A watermark, or a robot's own arm, is seen at one place by all.
    unsuited = (
        pycolmap.TwoViewGeometryConfiguration.WATERMARK,
        pycolmap.TwoViewGeometryConfiguration.DEGENERATE,
    )
    found = []
    for pair_id, geometry in zip(pair_ids, geometries, strict=True):
        first, second = (numbers[image] for image in pycolmap.pair_id_to_image_pair(pair_id))
        places = np.asarray(geometry.inlier_matches, dtype=np.int64).reshape(-1, 2)
        if geometry.config not in unsuited and len(places) >= FEWEST_MATCHES:
            kept = np.linspace(0, len(places) - 1, min(len(places), MATCHES_PER_PAIR)).round()
            here, there = places[kept.astype(int)].T
            found.append(Matches(first, second, rays[first][here], rays[second][there]))
    return sorted(found, key=lambda pair: (pair.first, pair.second))


def _camera(pycolmap: Any, frame: Frame, camera_id: int) -> Any:
    """Without skew, which only COLMAP's choice among matches would know of."""
    (focal_x, _, centre_x), (_, focal_y, centre_y), _ = frame.intrinsics
    camera = pycolmap.Camera(
        camera_id=camera_id,
        model="PINHOLE",
        width=frame.size[0],
        height=frame.size[1],
        params=[focal_x, focal_y, centre_x, centre_y],
    )
    camera.has_prior_focal_length = True
    return camera


def _rays(
    pixels: Float[np.ndarray, "point 2"], intrinsics: Float[np.ndarray, "3 3"]
) -> Float[Tensor, "point 3"]:
    points = np.column_stack([pixels, np.ones(len(pixels))]).astype(np.float64)
    return torch.from_numpy(points @ np.linalg.inv(intrinsics).T)
