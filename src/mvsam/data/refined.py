"""Poses that a tracker gave, corrected by the photos: `mvsam predict --poses refined`.

Trackers, SLAM and depth cameras whose colour comes a moment later are off by half a degree and a
few centimetres. COLMAP matches features, `geometry.epipolar` moves the cameras.
"""

import logging
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from PIL import Image

from mvsam.data.readers.colmap import import_pycolmap
from mvsam.data.readers.structure import match_features
from mvsam.data.wrapped import WrappedScene
from mvsam.geometry.epipolar import Matches, epipolar_distances, fit_poses
from mvsam.types import Frame, Scene

WIDTH = 640
"""Features of a photo are found to a pixel; of a larger one than this to a pixel of this width."""
GOOD_ENOUGH = 0.4
"""Of such a pixel, the median distance of the matches. Up to it features say less about the cameras
than the cameras do: on rooms, whose cameras are exact, it is 0.1 to 0.5 (docs/log.md)."""
FEWEST_MATCHES = 15
"""Of a pair; fewer may be chance."""
MOST_MATCHES = 100
"""Of a pair, drawn evenly; more add time alone."""
SMALLEST_BASELINE = 0.01
"""Metres; nearer cameras have no epipolar lines to speak of."""
DECIMALS = 9
"""Below them runs differ, and then `predict` would not go on where it stopped."""

log = logging.getLogger("mvsam")


class RefinedScene(WrappedScene):
    """The same scene with its cameras moved to where its photos match.

    Photos without matches keep their pose, and all do where they fit already. Unit, world axes and
    the cameras' distances stay as they are, on the whole. A message says how far the cameras moved.
    """

    def __init__(self, scene: Scene):
        super().__init__(scene)
        frames = [scene.frame(index) for index in range(len(scene))]
        self._poses = refined_poses(scene.name, frames)

    def frame(self, index: int) -> Frame:
        return replace(self._scene.frame(index), world_from_cam=self._poses[index])


def refined_poses(name: str, frames: Sequence[Frame]) -> list[Float[np.ndarray, "4 4"]]:
    """As `RefinedScene`; `name` is for its messages."""
    as_given = [frame.world_from_cam for frame in frames]
    given = torch.from_numpy(np.stack(as_given)).double()
    pairs = [
        pair
        for pair in _matches(frames)
        if (given[pair.first, :3, 3] - given[pair.second, :3, 3]).norm() >= SMALLEST_BASELINE
    ]
    if not pairs:
        log.warning(
            "%s: no two of its photos have %d features in common, so they cannot correct the "
            "cameras, which stay as given.",
            name, FEWEST_MATCHES,
        )  # fmt: skip
        return as_given
    pixel = float(np.median([1 / frame.intrinsics[0, 0] for frame in frames]))
    blur = max(1.0, np.median([frame.size[0] for frame in frames]) / WIDTH)
    before = epipolar_distances(given, pairs).median().item() / pixel
    if before <= GOOD_ENOUGH * blur:
        log.warning(
            "%s: its cameras fit its photos (matches are %.1f pixels from their epipolar lines) "
            "and stay as given.",
            name, before,
        )  # fmt: skip
        return as_given
    poses = fit_poses(given, pairs, spread=blur * pixel)
    after = epipolar_distances(poses, pairs).median().item() / pixel
    moved = sorted({index for pair in pairs for index in (pair.first, pair.second)})
    degrees, metres = _way(given[moved], poses[moved])
    alone = len(given) - len(moved)
    log.warning(
        "%s: its photos turned the cameras by %.2f degrees and moved them by %.1f cm (medians); "
        "matches are %.1f pixels from their epipolar lines, %.1f before%s.",
        name, degrees, 100 * metres, after, before,
        f"; {alone} of {len(given)} photos match no other and stay" if alone else "",
    )  # fmt: skip
    return list(poses.numpy().round(DECIMALS))


def _way(
    given: Float[torch.Tensor, "view 4 4"], found: Float[torch.Tensor, "view 4 4"]
) -> tuple[float, float]:
    """Medians: (degrees, metres) between two poses of each camera."""
    traces = torch.einsum("vij,vij->v", given[:, :3, :3], found[:, :3, :3])
    angles = ((traces - 1) / 2).clamp(-1, 1).acos().rad2deg()
    distances = (given[:, :3, 3] - found[:, :3, 3]).norm(dim=1)
    return angles.median().item(), distances.median().item()


def _matches(frames: Sequence[Frame]) -> list[Matches]:
    """Of all pairs with enough of them."""
    pycolmap: Any = import_pycolmap()
    pycolmap.logging.minloglevel = 2  # errors only
    pycolmap.set_random_seed(0)
    with tempfile.TemporaryDirectory() as folder:
        photos, database = Path(folder) / "photos", Path(folder) / "database.db"
        photos.mkdir()
        names = [f"{index:06d}.png" for index in range(len(frames))]
        for name, frame in zip(names, frames, strict=True):
            Image.fromarray(frame.image).save(photos / name, compress_level=1)
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.num_threads = 1  # else COLMAP numbers photos as they get ready, and matches so
        pycolmap.extract_features(
            database,
            photos,
            image_names=names,
            camera_mode=pycolmap.CameraMode.PER_IMAGE,
            extraction_options=extraction,
        )
        with pycolmap.Database.open(database) as opened:
            images = [opened.read_image_with_name(name) for name in names]
            for image, frame in zip(images, frames, strict=True):
                opened.update_camera(_camera(pycolmap, frame, image.camera_id))
        match_features(pycolmap, database, len(frames))
        with pycolmap.Database.open(database) as opened:
            ids = [image.image_id for image in images]
            rays = [
                _rays(opened.read_keypoints(image_id)[:, :2], frame.intrinsics)
                for image_id, frame in zip(ids, frames, strict=True)
            ]
            pair_ids, geometries = opened.read_two_view_geometries()
    found = []
    for pair_id, geometry in zip(pair_ids, geometries, strict=True):
        first, second = map(ids.index, pycolmap.pair_id_to_image_pair(pair_id))
        places = np.asarray(geometry.inlier_matches, dtype=np.int64).reshape(-1, 2)
        if len(places) >= FEWEST_MATCHES:
            kept = np.linspace(0, len(places) - 1, min(len(places), MOST_MATCHES)).round()
            here, there = places[kept.astype(int)].T
            found.append(Matches(first, second, rays[first][here], rays[second][there]))
    return sorted(found, key=lambda pair: (pair.first, pair.second))


def _camera(pycolmap: Any, frame: Frame, camera_id: int) -> Any:
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
) -> Float[torch.Tensor, "point 3"]:
    points = np.column_stack([pixels, np.ones(len(pixels))]).astype(np.float64)
    return torch.from_numpy(points @ np.linalg.inv(intrinsics).T)
