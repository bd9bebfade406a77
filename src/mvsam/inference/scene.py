"""A scene in, a folder of maps out: every photo in turn is the reference."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from mvsam.data.about import About
from mvsam.data.check.evidence import camera_warning
from mvsam.data.depth_range import DepthRange, DepthRangeOrAuto, share_outside
from mvsam.data.labels import ClassTable, classes_of_model
from mvsam.data.sampling import ViewTuple, view_tuples
from mvsam.device import device_of
from mvsam.errors import InputError, counted
from mvsam.evaluation.evaluate import Scores
from mvsam.files import write_json
from mvsam.inference.fusing import fuse_folder
from mvsam.inference.limits import REMEMBERED_PHOTOS, count_needs, photos_within
from mvsam.inference.outputs import OutputFolder, PhotoPrediction
from mvsam.inference.photos import (
    MOST_VIEWS,
    check_measured_depth,
    check_size,
    fewest_views,
    resolved_depth_range,
    warn_of_other_range,
)
from mvsam.inference.record import (
    check_same_run,
    describe_cost,
    describe_run,
    is_same_run,
    peak_memory_mb,
)
from mvsam.inference.scoring import score_folder
from mvsam.inference.session import Session
from mvsam.memory import memory_in_use
from mvsam.precision import Precision
from mvsam.types import Frame, Model, Scene

log = logging.getLogger("mvsam")

LEAST_SKEW = 0.01
"""Pixels."""
MOST_OUTSIDE, ALL_OUTSIDE = 0.25, 0.95
"""Shares of the sparse points: few lie beyond a range that fits, nearly all where poses have no
unit. Above the first `predict` warns, above the second it stops."""


@dataclass(frozen=True)
class SceneResult:
    """What `predict_scene` did; photos by their names, where nothing else is said."""

    written: list[str]
    kept: list[str]
    """Were done by an earlier run."""
    skipped: list[str]
    """No other photo overlaps these."""
    scores: Scores | None
    """Those of `metrics.json`; None where the scene has no ground truth."""
    tuples: list[ViewTuple]
    """Photos that were seen together, by index: each reference and its sources."""


def predict_scene(
    model: Model,
    scene: Scene,
    out: str | Path,
    num_views: int = 3,
    depth_range: DepthRangeOrAuto = (0.1, 5.0),
    references: Sequence[str] | None = None,
    overwrite: bool = False,
    save_npz: bool = False,
    precision: Precision = "auto",
    size: tuple[int, int] | None = None,
    max_memory: int | None = None,
    fuse: bool = True,
    arguments: dict[str, Any] | None = None,
    on_photo: Callable[[int, int, str], None] = lambda done, total, name: None,
) -> SceneResult:
    """Writes depth, confidence and labels of a scene's photos into the folder `out`.

    Each reference is seen together with its `num_views` - 1 best sources, alone by a model of
    single pictures; `references` are names of photos, all by default. `depth_range` is metres, or
    "auto": an estimate from the scene's sparse points (`scene.points`, where it has them) or its
    poses. Photos that are done are kept unless `overwrite`. `save_npz` adds float32 depth.
    `precision` auto takes bfloat16 where the processor or the GPU multiplies it natively.
    `size` is the (width, height) at which the network sees photos; None: `model.input_size`.
    `max_memory` are the bytes this process may come to hold where the model is (RAM or GPU); with
    less, fewer photos are remembered, so it takes longer. It is an estimate (`limits.count_needs`),
    not a guarantee. With `fuse` the maps of all photos in the folder correct each
    other in the end (`fusing.py`), in two megabytes of RAM a photo. `arguments` are recorded
    in `run.json` as they are.
    `on_photo(done, total, name)` is called after each photo.

    What exists in `out` is whole at any time; after an interruption the next call goes on.
    Raises `InputError` for bad input and `DiskFullError`.
    """
    check_size(size)
    num_views = _views_for(model, num_views)
    frames = [scene.frame(index) for index in range(len(scene))]
    points = About.of(scene).points
    depth_range = resolved_depth_range(depth_range, frames, points)
    warn_of_other_range(model, depth_range)
    if num_views > 1:
        _check_points(scene.name, frames, points, depth_range)
    all_tuples, skipped = view_tuples(scene, num_views, depth_range)
    tuples = _tuples_of(references, all_tuples, frames, scene.name)
    if references is not None:
        skipped = [name for name in skipped if name in references]
    _warn_of_cameras(scene.name, frames, skipped, depth_range)
    chosen = [frames[views[0]] for views in tuples]
    check_measured_depth(model, chosen)
    size = size or model.input_size
    remembered_photos = _photos_within(max_memory, model, size, frames, num_views)
    folder = OutputFolder(Path(out))
    seen = (model, scene.name, frames, num_views, all_tuples, depth_range, size)
    run = describe_run(*seen, precision, fuse, arguments)
    _prepare(folder, run, chosen, overwrite, save_npz)
    folder.remove_partial()
    with Session(model, depth_range, remembered_photos, precision, size) as session:
        work = _Work(session, frames, folder, run, save_npz)
        work.predict_all(tuples, on_photo)
    if fuse:
        work.fuse()
    scores = _scores(folder, scene, frames, work.classes)
    return SceneResult(work.written, work.kept, skipped, scores, tuples)


def _check_same_photos(folder: OutputFolder, references: Sequence[Frame]) -> None:
    """Raises `InputError` where a photo is another than the one that was predicted."""
    for frame in references:
        if folder.is_done(frame.name) and not folder.shows(frame):
            raise InputError(
                f"{folder.path} holds predictions of another photo {frame.name}: choose another "
                "--out, or add --overwrite to replace them."
            )


def _views_for(model: Model, asked: int) -> int:
    """One for a model of single pictures; InputError for more or fewer than others take."""
    if fewest_views(model) == 1:
        return 1
    if not 2 <= asked <= MOST_VIEWS:
        raise InputError(
            f"{counted(asked, 'view')} asked for: a prediction looks at 2 to {MOST_VIEWS}."
        )
    return asked


def _scores(
    folder: OutputFolder, scene: Scene, frames: Sequence[Frame], classes: ClassTable
) -> Scores | None:
    """Of what lies in the folder; labels count where the scene's classes are the model's."""
    is_same = About.of(scene).classes.names == classes.names
    return score_folder(folder, scene.name, frames, len(classes) if is_same else None)


def _check_points(
    scene: str, frames: Sequence[Frame], points: np.ndarray | None, depth_range: DepthRange
) -> None:
    """Warns where many lie outside the range; InputError where nearly all do."""
    outside = 0.0 if points is None else share_outside(frames, points, depth_range)
    if outside <= MOST_OUTSIDE:
        return
    sentence = (
        f"{scene}: {100 * outside:.0f} % of its sparse points lie outside {depth_range[0]:g} to "
        f"{depth_range[1]:g} m, where no surface is sought: give --scale where the poses have no "
        "unit, or --depth-range auto."
    )
    if outside > ALL_OUTSIDE:
        raise InputError(sentence)
    log.warning("%s", sentence)


def _warn_of_cameras(
    scene: str, frames: Sequence[Frame], skipped: Sequence[str], depth_range: DepthRange
) -> None:
    for name in skipped:
        log.warning("%s: no other photo overlaps it; it is skipped.", name)
    if warning := camera_warning(frames, depth_range):
        log.warning("%s: %s", scene, warning)
    if any(abs(frame.intrinsics[0, 1]) > LEAST_SKEW for frame in frames):
        log.warning(
            "%s: its pixels have a skew, which transforms.json cannot hold: mvsam reconstruct will "
            "do without it.",
            scene,
        )


class _Work:
    """The loop over the references."""

    def __init__(
        self,
        session: Session,
        frames: list[Frame],
        folder: OutputFolder,
        run: dict[str, Any],
        save_npz: bool,
    ):
        self.session, self.frames, self.folder = session, frames, folder
        self.run, self.save_npz = run, save_npz
        self.classes = classes_of_model(session.model)
        self.written: list[str] = []
        self.kept: list[str] = []

    def predict_all(
        self, tuples: Sequence[ViewTuple], on_photo: Callable[[int, int, str], None]
    ) -> None:
        """Also after Ctrl-C the folder's index lists the photos that are done."""
        try:
            self._predict_missing(tuples, on_photo)
        finally:
            if self.folder.kinds:
                self.folder.write_index(self.frames, self.classes)

    def _predict_missing(
        self, tuples: Sequence[ViewTuple], on_photo: Callable[[int, int, str], None]
    ) -> None:
        names = [self.frames[views[0]].name for views in tuples]
        done = {name for name in names if self.folder.is_done(name)}
        to_do = [views for name, views in zip(names, tuples, strict=True) if name not in done]
        predictions = self.session.predict_all(
            [[self.frames[index] for index in views] for views in to_do]
        )
        for count, name in enumerate(names, start=1):
            if name in done:
                self.kept.append(name)
            else:
                self._write(self.frames[tuples[count - 1][0]], next(predictions))
                self.written.append(name)
            on_photo(count, len(tuples), name)
        if self.written:
            self._write_run(describe_cost(self.session.stopwatch.seconds, len(self.written)))

    def fuse(self) -> None:
        """Unless the folder says that it was done since its last photo came."""
        run = self.folder.read_run()
        if run is None or run.get("is_fused"):
            return
        with self.session.stopwatch("fuse"):
            if not fuse_folder(self.folder, self.frames, self.classes):
                return
        taken = round(self.session.stopwatch.seconds["fuse"], 3)
        run["seconds"] = run.get("seconds", {}) | {"fuse": taken}
        run |= {"peak_memory_mb": peak_memory_mb(), "is_fused": True}
        write_json(self.folder.path / "run.json", run)

    def _write(self, frame: Frame, prediction: PhotoPrediction) -> None:
        if not self.folder.kinds:
            self.folder.kinds = prediction.kinds(self.save_npz, self.run["fuse"])
        if not self.written:
            # Before the first map, so that a later run knows whose maps these are.
            self._write_run({})
        with self.session.stopwatch("write"):
            self.folder.write_photo(frame.name, frame.image, prediction, self.classes)

    def _write_run(self, cost: dict[str, Any]) -> None:
        write_json(self.folder.path / "run.json", self.run | {"kinds": self.folder.kinds} | cost)


def _photos_within(
    limit: int | None,
    model: Model,
    size: tuple[int, int],
    frames: Sequence[Frame],
    num_views: int,
) -> int:
    """How many encoded photos to remember; InputError where even the fewest are too many."""
    if limit is None:
        return REMEMBERED_PHOTOS
    largest = max(width * height for width, height in (frame.size for frame in frames))
    needs = count_needs(model, size, num_views, largest)
    return photos_within(limit, memory_in_use(device_of(model).type), needs, num_views)


def _tuples_of(
    references: Sequence[str] | None, tuples: list[ViewTuple], frames: list[Frame], scene: str
) -> list[ViewTuple]:
    """Those of the references asked for, all for None; InputError where there is none."""
    if references is None:
        return tuples
    names = [frame.name for frame in frames]
    for name in references:
        if name not in names:
            close = get_close_matches(name, names) or [names[0], "...", names[-1]]
            raise InputError(f"{scene} has no photo named {name}; it has {', '.join(close)}.")
    chosen = [views for views in tuples if names[views[0]] in references]
    if not chosen:
        raise InputError(
            f"{scene}: none of the references {', '.join(references)} has a source that "
            "overlaps it; choose others."
        )
    return chosen


def _prepare(
    folder: OutputFolder,
    run: dict[str, Any],
    references: Sequence[Frame],
    overwrite: bool,
    save_npz: bool,
) -> None:
    """Finds out what is done; with `overwrite` removes what is to be made anew.

    Maps of another model go altogether then, not only those of the references, so that a folder
    never mixes two.
    """
    before = folder.read_run()
    if before is None:
        folder.check_unused()
        return
    if not overwrite:
        check_same_run(run, before, folder.path)
        _check_same_photos(folder, references)
    elif is_same_run(run, before):
        folder.remove([frame.name for frame in references])
    else:
        folder.remove_all()
    if save_npz:
        folder.add_float_depth()
