"""Poses that a tracker gave, corrected by the photos: `--poses refined`.

Trackers, SLAM and depth cameras whose colour comes a moment later are off by half a degree and a
few centimetres. COLMAP matches features, `geometry.epipolar` moves the cameras.
"""

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from math import inf

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mvsam.data.matches import FEWEST_MATCHES, match_photos, pixel_size
from mvsam.data.readers.colmap import import_pycolmap
from mvsam.data.readers.structure import MOST_MATCHED
from mvsam.data.wrapped import WrappedScene
from mvsam.errors import InputError
from mvsam.geometry.epipolar import Matches, epipolar_distances, fit_poses
from mvsam.types import Frame, Scene

GOOD_ENOUGH = 0.7
"""Pixels of a photo 640 wide: the median distance of every camera's matches from their epipolar
lines. Up to it features say less about the cameras than the cameras do (docs/log.md)."""
MOST_OFF, AGREED = 8.0, 2.0
"""Of such pixels: a camera with a larger median before is mistaken, not imprecise, as those of
another convention; with a larger one of all afterwards, the photos do not agree on others."""
MOST_MISTAKEN = 1 / 3
"""Of the cameras that match; with more, none can be told from the others."""
SMALLEST_BASELINE = 0.01
"""Metres; nearer cameras have no epipolar lines to speak of."""
DECIMALS = 9
"""Below them runs differ, and then `predict` would not go on where it stopped."""

log = logging.getLogger("mvsam")


class RefinedScene(WrappedScene):
    """The same scene, in metres, with its cameras moved to where its photos match.

    They stay where they fit already or the photos cannot tell, and so do those of photos without
    matches. Unit, world axes and the cameras' distances stay, on the whole. A message says what was
    done. The first `frame` reads every photo and takes seconds to minutes; InputError for more
    than 150. Raises `MissingExtraError` without the extra `colmap`.
    """

    def __init__(self, scene: Scene):
        super().__init__(scene)
        import_pycolmap("corrected poses")  # what is missing is said now

    @cached_property
    def _poses(self) -> list[Float[np.ndarray, "4 4"]]:
        """Of the photos that occur in prescribed tuples, of all where none are prescribed."""
        frames = [self._scene.frame(index) for index in range(len(self))]
        views = self.views()
        used = range(len(self)) if views is None else sorted({i for v in views for i in v})
        poses = [frame.world_from_cam for frame in frames]
        refined = refined_poses(self.name, [frames[index] for index in used])
        for index, pose in zip(used, refined, strict=True):
            poses[index] = pose
        return poses

    def frame(self, index: int) -> Frame:
        return replace(self._scene.frame(index), world_from_cam=self._poses[index])


def refined_poses(name: str, frames: Sequence[Frame]) -> list[Float[np.ndarray, "4 4"]]:
    """As `RefinedScene`; `name` is for its messages."""
    if len(frames) > MOST_MATCHED:
        raise InputError(
            f"{name}: has {len(frames)} photos; every pair is matched to correct poses, of "
            f"{MOST_MATCHED} at most. Take some of a recording, or leave the poses as given."
        )
    as_given = [frame.world_from_cam.astype(np.float64) for frame in frames]
    if len(frames) < 2:
        return as_given
    given = torch.from_numpy(np.stack(as_given))
    pairs = _matched_apart(name, frames, given)
    if not pairs:
        return as_given
    fitted = _fitted(name, frames, given, pairs)
    return as_given if fitted is None else list(fitted.numpy().round(DECIMALS))


def _matched_apart(
    name: str, frames: Sequence[Frame], given: Float[Tensor, "view 4 4"]
) -> list[Matches]:
    """Of photos that match and are not at one place; a message says why there are none."""
    log.info("%s: COLMAP matches the features of %d photos.", name, len(frames))
    matched = match_photos(name, frames)
    pairs = apart(matched, given)
    if not pairs:
        reason = (
            f"those that match are less than {SMALLEST_BASELINE * 100:g} cm apart"
            if matched
            else f"no two have {FEWEST_MATCHES} features in common"
        )
        log.warning("%s: its photos cannot correct the cameras: %s.", name, reason)
    return pairs


def apart(pairs: Sequence[Matches], poses: Float[Tensor, "view 4 4"]) -> list[Matches]:
    """Those whose cameras have epipolar lines to speak of."""
    return [
        pair
        for pair in pairs
        if (poses[pair.first, :3, 3] - poses[pair.second, :3, 3]).norm() >= SMALLEST_BASELINE
    ]


def _fitted(
    name: str,
    frames: Sequence[Frame],
    given: Float[Tensor, "view 4 4"],
    pairs: Sequence[Matches],
) -> Float[Tensor, "view 4 4"] | None:
    """The corrected poses, None where the given ones are to stay; a message says which and why."""
    pixel = pixel_size(frames)
    kept, mistaken = without_mistaken(given, pairs, MOST_OFF * pixel)
    for index in mistaken:
        log.warning(
            "%s: the camera of %s is mistaken and stays as given (its features are more than %g "
            "pixels from their epipolar lines): correct it, or leave it out.",
            name, frames[index].name, MOST_OFF,
        )  # fmt: skip
    distances = epipolar_distances(given, kept or pairs)
    before = torch.cat(distances).median().item() / pixel
    if kept and max(camera_distances(distances, kept).values()) <= GOOD_ENOUGH * pixel:
        log.info(
            "%s: its %scameras fit its photos (features are %.1f pixels from their epipolar lines) "
            "and stay as given.",
            name, "other " if mistaken else "", before,
        )  # fmt: skip
        return None
    poses = fit_poses(given, kept, spread=pixel)
    after = torch.cat(epipolar_distances(poses, kept)).median().item() / pixel if kept else inf
    if after > AGREED:
        log.warning(
            "%s: its photos disagree with its cameras (features are %.1f pixels from their "
            "epipolar lines), which stay as given; mvsam data check may say what is wrong.",
            name, before,
        )  # fmt: skip
        return None
    moved = _cameras(kept)
    degrees, metres = _way(given[moved], poses[moved])
    others = len(given) - len(moved) - len(mistaken)
    log.info(
        "%s: its photos turned the cameras by %.2f degrees and moved them by %.1f cm (medians); "
        "features are %.1f pixels from their epipolar lines, %.1f before%s.",
        name, degrees, 100 * metres, after, before,
        f"; {others} of {len(given)} photos have no partner and stay" if others else "",
    )  # fmt: skip
    return poses


def camera_distances(
    distances: Sequence[Float[Tensor, "_match"]], pairs: Sequence[Matches]
) -> dict[int, float]:
    """Camera -> the median over all of its matches: of a log, a part may be off."""
    of_cameras: dict[int, list[Tensor]] = {}
    for pair, found in zip(pairs, distances, strict=True):
        for camera in (pair.first, pair.second):
            of_cameras.setdefault(camera, []).append(found)
    return {index: torch.cat(found).median().item() for index, found in of_cameras.items()}


def without_mistaken(
    given: Float[Tensor, "view 4 4"], pairs: Sequence[Matches], most: float
) -> tuple[list[Matches], list[int]]:
    """(the pairs of cameras that are off by `most` at most, the cameras that are off by more).

    A mistaken camera spoils the distances of those that match it, so they go one by one, worst
    first. It is told by partners that agree without it: who has none left is neither kept nor
    mistaken. Both are empty where more than `MOST_MISTAKEN` of the cameras would have to go.
    """
    kept, gone = list(pairs), []
    while kept:
        off = camera_distances(epipolar_distances(given, kept), kept)
        worst = max(off, key=lambda index: off[index])
        if off[worst] <= most:
            break
        gone.append(worst)
        kept = [pair for pair in kept if worst not in (pair.first, pair.second)]
    if len(gone) > MOST_MISTAKEN * len(_cameras(pairs)):
        return [], []
    agreeing = set(_cameras(kept))
    partners = {frozenset((pair.first, pair.second)) for pair in pairs}
    told = [i for i in gone if any(frozenset((i, other)) in partners for other in agreeing)]
    return kept, told


def _cameras(pairs: Sequence[Matches]) -> list[int]:
    return sorted({index for pair in pairs for index in (pair.first, pair.second)})


def _way(given: Float[Tensor, "view 4 4"], found: Float[Tensor, "view 4 4"]) -> tuple[float, float]:
    """Medians: (degrees, metres) between two poses of each camera."""
    # The chord, not the trace: small angles from rotations that a file rounded.
    chords = (given[:, :3, :3] - found[:, :3, :3]).flatten(1).norm(dim=1)
    angles = 2 * (chords / 8**0.5).clamp(max=1).asin().rad2deg()
    distances = (given[:, :3, 3] - found[:, :3, 3]).norm(dim=1)
    return angles.median().item(), distances.median().item()
