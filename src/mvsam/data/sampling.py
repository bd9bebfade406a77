"""Which views go together: sources ranked by the overlap of viewing frusta and their baseline."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Bool

from mvsam.data.check.poses import pose_convention_hint
from mvsam.data.depth_range import DepthRange
from mvsam.data.frusta import Cameras, angle_preference, frustum_overlap
from mvsam.data.keyframes import keyframes
from mvsam.errors import InputError
from mvsam.types import Frame, Scene

Item = TypeVar("Item")
ViewTuple = tuple[int, ...]
"""Frame indices: the reference, then its sources, best first."""

MINIMUM_BASELINE = 0.03
"""Metres; closer views show nearly the same picture and are used only if nothing else overlaps."""
MINIMUM_OVERLAP = 0.1
"""Fraction of their frusta that two views must share to be matched."""
MOST_AT_ONCE = 400
"""Frames whose pairs are all looked at."""
KEYFRAME_BASELINE, KEYFRAME_ANGLE_DEG = 0.05, 5.0
"""Metres and degrees between those among which the sources of longer recordings are sought."""


def view_tuples(
    scene: Scene,
    num_views: int,
    depth_range: DepthRange,
    minimum_baseline: float = MINIMUM_BASELINE,
) -> tuple[list[ViewTuple], list[str]]:
    """(the tuples to predict, the names of frames skipped because no other frame overlaps them).

    A scene that prescribes tuples keeps them, cut to `num_views`; otherwise every frame is a
    reference, with the sources of `rank_sources`. With one view, for models of single pictures, the
    references stand alone. Raises `InputError` when no tuple is left.
    """
    if num_views < 1:
        raise InputError(f"{num_views} views are none; ask for 1, or for stereo for 2 or more.")
    prescribed = scene.views()
    if num_views == 1:
        alone = range(len(scene)) if prescribed is None else [views[0] for views in prescribed]
        return [(reference,) for reference in alone], []
    if len(scene) < 2:
        raise InputError(
            f"{scene.name}: depth needs at least two posed photos, found {len(scene)}; add more."
        )
    frames = [scene.frame(index) for index in range(len(scene))]
    if prescribed is not None:
        cut = [views[:num_views] for views in prescribed]
        tuples, skipped = _drop_blind(frames, cut, depth_range)
    else:
        tuples, skipped = rank_sources(frames, depth_range, num_views, minimum_baseline)
    if not tuples:
        advice = pose_convention_hint(frames, depth_range) or (
            "check that the poses are camera-to-world and in metres."
        )
        raise InputError(
            f"{scene.name}: no photo overlaps its sources between {depth_range[0]:g} and "
            f"{depth_range[1]:g} m; {advice}"
        )
    return tuples, skipped


def _drop_blind(
    frames: Sequence[Frame], tuples: Sequence[ViewTuple], depth_range: DepthRange
) -> tuple[list[ViewTuple], list[str]]:
    """Leaves out prescribed tuples in which no source sees anything of the reference."""
    sees = [
        frustum_overlap(Cameras.of([frames[i] for i in views]), depth_range)[0].any()
        for views in tuples
    ]
    kept = [views for views, is_seen in zip(tuples, sees, strict=True) if is_seen]
    return kept, [
        frames[views[0]].name for views, is_seen in zip(tuples, sees, strict=True) if not is_seen
    ]


def rank_sources(
    frames: Sequence[Frame],
    depth_range: DepthRange,
    num_views: int,
    minimum_baseline: float = MINIMUM_BASELINE,
) -> tuple[list[ViewTuple], list[str]]:
    """(one tuple for each frame that some other overlaps, the names of the frames that have none).

    Sources are ranked by overlap times the preference for useful triangulation angles; those nearer
    than `minimum_baseline` metres come after all others. Of more than 400 frames, sources are
    sought among the nearest keyframes, and where too few of them overlap among the frames recorded
    around: time and memory grow with the square of the number.
    """
    if len(frames) <= MOST_AT_ONCE:
        return _rank_all(frames, depth_range, num_views, minimum_baseline)
    poses = np.stack([frame.world_from_cam for frame in frames])
    kept = np.array(keyframes(list(poses), KEYFRAME_BASELINE, KEYFRAME_ANGLE_DEG))
    tuples, skipped = [], []
    for first in range(0, len(frames), MOST_AT_ONCE // 4):
        references = range(first, min(first + MOST_AT_ONCE // 4, len(frames)))
        middle = np.median(poses[references, :3, 3], axis=0)
        order = np.linalg.norm(poses[kept, :3, 3] - middle, axis=1).argsort(kind="stable")
        near = [i for i in kept[order].tolist() if i not in references]
        chosen = [*references, *near[: MOST_AT_ONCE - len(references)]]
        part = [frames[index] for index in chosen]
        found, lonely = _rank_all(
            part,
            depth_range,
            num_views,
            minimum_baseline,
            num_references=len(references),
            is_source=np.isin(chosen, kept),
        )
        tuples += [tuple(chosen[i] for i in views) for views in found]
        skipped += lonely
    return tuples, skipped


def _rank_all(
    frames: Sequence[Frame],
    depth_range: DepthRange,
    num_views: int,
    minimum_baseline: float,
    num_references: int | None = None,
    is_source: Bool[np.ndarray, " frame"] | bool = True,
) -> tuple[list[ViewTuple], list[str]]:
    """`rank_sources` of the first `num_references` frames.

    is_source: which are to be sources; all of them where those are too few.
    """
    cameras = Cameras.of(frames)
    shared = frustum_overlap(cameras, depth_range)
    baselines = np.linalg.norm(cameras.centres[:, None] - cameras.centres[None], axis=-1)
    usefulness = shared * angle_preference(cameras, depth_range)
    # Among views that are all too close, the widest baseline is worth most.
    score = np.where(baselines >= minimum_baseline, usefulness, baselines - minimum_baseline)
    tuples, skipped = [], []
    for reference, frame in enumerate(frames[:num_references]):
        overlaps = shared[reference] >= MINIMUM_OVERLAP
        candidates = np.flatnonzero(overlaps & is_source)
        if len(candidates) < num_views - 1:
            candidates = np.flatnonzero(overlaps)
        order = candidates[np.argsort(-score[reference, candidates], kind="stable")]
        if len(order):
            tuples.append((reference, *order[: num_views - 1].tolist()))
        else:
            skipped.append(frame.name)
    return tuples, skipped


def evenly_spaced(items: Sequence[Item], limit: int | None) -> list[Item]:
    """At most `limit` of them, spread evenly from the first to the last."""
    if limit is None or len(items) <= limit:
        return list(items)
    return [items[round(position)] for position in np.linspace(0, len(items) - 1, limit)]
