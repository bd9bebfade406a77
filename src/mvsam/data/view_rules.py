"""Published rules of which frames of a recording are seen together, and tuples from files."""

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from mvsam.data.about import About
from mvsam.data.depth_range import DepthRangeOrAuto, estimate_depth_range
from mvsam.data.keyframes import keyframes
from mvsam.data.lazy import LazyScenes, changed
from mvsam.data.sampling import ViewTuple, rank_sources
from mvsam.data.splits import TuplesByScene, read_tuples
from mvsam.data.wrapped import WrappedScene
from mvsam.errors import InputError
from mvsam.types import Scene

FRAME_STEP = 20
"""MVS2D's: neighbouring views are so many frames of the recording apart."""
BENCHMARK_STEP = 100
"""References of ScanNet's 2D benchmark are so many frames apart (scannet_frames_25k)."""
RULES = ("mvs2d", "every-100", "keyframes")


class PrescribedScene(WrappedScene):
    """A scene with view tuples from elsewhere."""

    def __init__(self, scene: Scene, tuples: list[ViewTuple]):
        super().__init__(scene)
        self._tuples = tuples

    def views(self) -> list[ViewTuple]:
        return self._tuples


def prescribe(
    scenes: Sequence[Scene], rule: str, num_views: int, depth_range: DepthRangeOrAuto
) -> LazyScenes:
    """The scenes with the tuples of a rule of `RULES`, or of a file (MVS2D's .npy, or text).

    mvs2d: every 20th frame with its neighbours. every-100: references as ScanNet's 2D benchmark,
    sources as mvs2d. keyframes: frames 10 cm or 15 degrees apart, sources by overlap among them.
    Scenes that a file does not name are left out. A rule is applied to a scene when that is opened.
    """
    if (by_scene := read_rule(rule)) is not None:
        return _from_file(scenes, by_scene, rule, num_views)
    tuples_of = {
        "mvs2d": partial(window_tuples, num_views=num_views),
        "every-100": partial(window_tuples, num_views=num_views, reference_step=BENCHMARK_STEP),
        "keyframes": partial(keyframe_tuples, num_views=num_views, depth_range=depth_range),
    }[rule]
    return changed(scenes, partial(_with_rule, tuples_of))


def read_rule(rule: str) -> TuplesByScene | None:
    """The tuples of a file, None for one of `RULES`; InputError for what is neither."""
    if rule in RULES:
        return None
    if not rule.endswith((".npy", ".txt")):
        raise InputError(
            f"unknown rule of view tuples '{rule}'; choose one of {', '.join(RULES)}, or the path "
            "of a .npy or .txt file."
        )
    return read_tuples(Path(rule))


def _with_rule(tuples_of: Callable[[Scene], list[ViewTuple]], scene: Scene) -> Scene:
    return PrescribedScene(scene, tuples_of(scene))


def window_tuples(
    scene: Scene, num_views: int, reference_step: int = FRAME_STEP
) -> list[ViewTuple]:
    """MVS2D's rule, as its authors tell it (issue 12 of their repository), in DPSNet's manner.

    Of each recording every 20th frame is kept; sources are the reference's neighbours among
    those, as many before as behind it, shifted inward at both ends. References are the kept frames
    whose number divides by `reference_step`.
    """
    numbers = frame_numbers(scene)
    kept = [index for index, number in enumerate(numbers) if number % FRAME_STEP == 0]
    if len(kept) < 2:
        raise InputError(
            f"{scene.name}: of its {len(numbers)} frames {len(kept)} have a number that divides by "
            f"{FRAME_STEP}; the rule is for whole recordings, choose another."
        )
    return [
        _window(kept, place, num_views)
        for place, index in enumerate(kept)
        if numbers[index] % reference_step == 0
    ]


def _window(kept: list[int], place: int, num_views: int) -> ViewTuple:
    """Nearest first, the earlier of two first: 1120, 1100, 1140."""
    half = num_views // 2
    first = max(0, min(place - half, len(kept) - 2 * half - 1))
    around = [i for i in range(first, min(first + 2 * half + 1, len(kept))) if i != place]
    nearest = sorted(around, key=lambda i: (abs(i - place), i))[: num_views - 1]
    return (kept[place], *(kept[i] for i in nearest))


def frame_numbers(scene: Scene) -> list[int]:
    """The number at the end of each frame's name, or its place where names have none."""
    names = [scene.frame(index).name for index in range(len(scene))]
    found = [re.search(r"([0-9]{1,9})$", name) for name in names]
    numbers = [int(match[1]) for match in found if match]
    return numbers if len(set(numbers)) == len(names) else list(range(len(names)))


def keyframe_tuples(scene: Scene, num_views: int, depth_range: DepthRangeOrAuto) -> list[ViewTuple]:
    """The keyframes as references, each with the best sources among the others."""
    frames = [scene.frame(index) for index in range(len(scene))]
    if depth_range == "auto":
        depth_range = estimate_depth_range(frames, About.of(scene).points)
    kept = keyframes([frame.world_from_cam for frame in frames])
    tuples, _ = rank_sources([frames[i] for i in kept], depth_range, num_views)
    return [tuple(kept[i] for i in views) for views in tuples]


def _from_file(
    scenes: Sequence[Scene], by_scene: TuplesByScene, file: str, num_views: int
) -> LazyScenes:
    named = [
        partial(_with_tuples, scenes, place, _indices(scene, by_scene[scene.name], file, num_views))
        for place, scene in enumerate(scenes)
        if scene.name in by_scene
    ]
    if not named:
        raise InputError(
            f"{file}: names none of these scenes ({scenes[0].name}, ...) but "
            f"{next(iter(by_scene))}, ...; is it for other data?"
        )
    return LazyScenes(named)


def _with_tuples(scenes: Sequence[Scene], place: int, tuples: list[ViewTuple]) -> Scene:
    return PrescribedScene(scenes[place], tuples)


def _indices(
    scene: Scene, tuples: Sequence[tuple[int, ...]], file: str, num_views: int
) -> list[ViewTuple]:
    """Frame numbers as indices into the scene; tuples whose tracking was lost are an error."""
    index_of = {number: index for index, number in enumerate(frame_numbers(scene))}
    for number in (number for views in tuples for number in views[:num_views]):
        if number not in index_of:
            raise InputError(
                f"{file}: frame {number} of {scene.name} is not among its {len(scene)} frames; its "
                "tracking was lost, or the export is not complete."
            )
    return [tuple(index_of[number] for number in views[:num_views]) for views in tuples]
