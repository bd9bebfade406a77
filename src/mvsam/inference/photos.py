"""A few photos in memory in, depth and labels for each of them out."""

import logging
from collections.abc import Sequence
from functools import partial
from typing import Any, get_args

import numpy as np
from jaxtyping import Float

from mvsam.build import MODELS
from mvsam.data.camera_checks import check_intrinsics, check_pose
from mvsam.data.check.evidence import camera_warning
from mvsam.data.depth_range import (
    DepthRange,
    DepthRangeOrAuto,
    checked_depth_range,
    estimate_depth_range,
)
from mvsam.data.refined import refined_poses
from mvsam.errors import InputError, counted
from mvsam.geometry.camera import HALF_PIXEL
from mvsam.inference.fusing import fuse_predictions
from mvsam.inference.outputs import PhotoPrediction
from mvsam.inference.session import Session
from mvsam.precision import Precision
from mvsam.types import Frame, Model

log = logging.getLogger("mvsam")

MOST_VIEWS = 8
"""Photos that go through a model together at most."""

SIDE_STEP = 32
"""Pixels; sides of what a network sees must be multiples of it."""


def predict(
    model: Model,
    images: Sequence[Any],
    intrinsics: Sequence[Any] | np.ndarray,
    world_from_cam: Sequence[Any],
    depth_range: DepthRangeOrAuto = (0.1, 5.0),
    references: Sequence[int] | None = None,
    precision: Precision = "auto",
    size: tuple[int, int] | None = None,
    check_cameras: bool = True,
    fuse: bool = True,
) -> list[PhotoPrediction]:
    """Depth, confidence and labels of each reference, at its photo's own size.

    `images` are 2 to 8 photos of one place, H x W x 3 uint8 RGB, of any sizes. `intrinsics` are
    a 3x3 array for each, or one for all, as OpenCV calibrates them (centre of the first pixel at
    (0, 0)), for the photos as given.
    `world_from_cam` are 4x4 camera-to-world, metres, axes x right, y down, z forward.
    `depth_range` is (nearest, farthest) in metres, or "auto": an estimate from the poses
    (`data.depth_range`). `references` are indices of photos; all by
    default. Each reference is seen together with all other photos. `precision` auto takes bfloat16
    where the processor or the GPU multiplies it natively. `size` is the (width, height) at which
    the network sees the photos, multiples of 32; None: `model.input_size`. `tiny` finds finer depth
    with (480, 384) where cameras are right and photos as large. With `fuse` the maps of the
    references correct each other, which takes a tenth of the time.

    Returns one `PhotoPrediction` a reference: `depth` H x W float32 metres, `confidence` H x W
    float32 in 0..1, `labels` H x W uint8; None for what the model does not predict. Warns in the
    log where the cameras seem wrong, unless `check_cameras` is False: a robot whose cameras were
    checked once saves that time. Raises `InputError` that names the photo which is not so.
    """
    check_size(size)
    frames = _frames(images, intrinsics, world_from_cam)
    if precision not in get_args(Precision):
        raise InputError(f"precision {precision!r}: give one of {', '.join(get_args(Precision))}.")
    fewest = fewest_views(model)
    if not fewest <= len(images) <= MOST_VIEWS:
        raise InputError(
            f"{counted(len(images), 'photo')} given; give {fewest} to {MOST_VIEWS} that overlap, "
            "or a whole scene to mvsam predict."
        )
    depth_range = resolved_depth_range(depth_range, frames)
    warn_of_other_range(model, depth_range)
    if check_cameras and (warning := camera_warning(frames, depth_range)):
        log.warning("%s", warning)
    chosen = list(range(len(frames)) if references is None else _as_list(references))
    for reference in chosen:
        if not isinstance(reference, int | np.integer) or reference not in range(len(frames)):
            raise InputError(
                f"reference {reference} is not a photo; they are numbered 0 to {len(frames) - 1}."
            )
    # The reference comes first: a measured depth belongs to view 0.
    tuples = [[frames[r], *frames[:r], *frames[r + 1 :]] for r in chosen]
    check_measured_depth(model, [views[0] for views in tuples])
    with Session(model, depth_range, precision=precision, size=size) as session:
        predictions = list(session.predict_all(tuples))
    return fuse_predictions([views[0] for views in tuples], predictions) if fuse else predictions


def _as_list(references: Any) -> list[Any]:
    try:
        return list(references)
    except TypeError as error:
        raise InputError(
            f"references {references!r}: give a list of the photos' numbers, as [0]."
        ) from error


def refine_poses(
    images: Sequence[Any], intrinsics: Sequence[Any] | np.ndarray, world_from_cam: Sequence[Any]
) -> list[Float[np.ndarray, "4 4"]]:
    """Poses that the photos agree on, for `predict`, where those of a tracker are off.

    Arguments as `predict`, of 2 to 150 photos. Returns 4x4 float64 camera-to-world in their order,
    metres, axes x right, y down, z forward. World axes and the cameras' distances stay, on the
    whole; so do poses that fit already, and those of photos without matches. What was done is in
    the log `mvsam`, at level INFO. Raises `MissingExtraError` without the extra `colmap`,
    `InputError` as `predict`.
    """
    frames = _frames(images, intrinsics, world_from_cam)
    if len(frames) < 2:
        raise InputError(f"{counted(len(frames), 'photo')} given; give 2 or more that overlap.")
    return refined_poses("refine_poses", frames)


def _frames(
    images: Sequence[Any], intrinsics: Sequence[Any] | np.ndarray, world_from_cam: Sequence[Any]
) -> list[Frame]:
    if getattr(intrinsics, "shape", None) == (3, 3):  # one camera took them all
        intrinsics = [intrinsics] * len(images)
    if not len(images) == len(intrinsics) == len(world_from_cam):
        raise InputError(
            f"{len(images)} images, {len(intrinsics)} intrinsics and {len(world_from_cam)} poses "
            "were given; give one of each per photo."
        )
    photos = zip(images, intrinsics, world_from_cam, strict=True)
    return [_frame(f"photo {index}", *photo) for index, photo in enumerate(photos)]


def fewest_views(model: Model) -> int:
    """Photos that it needs at least (`ModelSpec.fewest_views`); two where that is not known."""
    spec = MODELS.get(model.info.model) if model.info else None
    return 2 if spec is None else spec.fewest_views


def check_size(size: Any) -> None:
    """Raises `InputError` for a (width, height) that fits no network; None is each model's own."""
    if size is None:
        return
    is_pair = isinstance(size, list | tuple) and len(size) == 2
    if not is_pair or any(
        not isinstance(side, int | np.integer) or side <= 0 or side % SIDE_STEP for side in size
    ):
        raise InputError(
            f"size {size} does not fit the network: give a width and a height that are multiples "
            f"of {SIDE_STEP}, as 320 256."
        )


def warn_of_other_range(model: Model, depth_range: DepthRange) -> None:
    """Says so where the weights were trained for other depths than are searched."""
    info = model.info
    if info and info.depth_range[1] > 1.01 * depth_range[1]:
        near, far = info.depth_range
        log.warning(
            "the model was trained for %g to %g m, and %g to %g m are searched; give the former as "
            "the depth range to search all of it.",
            *(near, far, *depth_range),
        )


def check_measured_depth(model: Model, references: Sequence[Frame]) -> None:
    """Raises `InputError` where the model reads depth that a reference lacks."""
    lacking = [frame.name for frame in references if frame.load_depth is None]
    if lacking and model.reads_depth:
        raise InputError(
            f"{lacking[0]}: has no measured depth, which this model reads ({len(lacking)} of "
            f"{len(references)} photos lack it): take a model of RGB views (mvsam models), give "
            "the scene's photos depth maps (docs/data.md), or in mvsam predict name others as "
            "--references."
        )


def resolved_depth_range(
    depth_range: DepthRangeOrAuto, frames: Sequence[Frame], points: np.ndarray | None = None
) -> DepthRange:
    """The range in metres; "auto" is estimated from the scene's points or its poses."""
    if isinstance(depth_range, str) and depth_range == "auto":
        return estimate_depth_range(frames, points)
    return checked_depth_range(depth_range)


def _frame(name: str, image: Any, intrinsics: Any, world_from_cam: Any) -> Frame:
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise InputError(
            f"{name}: the image is {image.dtype} of shape {image.shape}; give H x W x 3 uint8 RGB."
        )
    size = (image.shape[1], image.shape[0])
    intrinsics = _matrix(intrinsics, 3, f"{name}: the intrinsics")
    check_intrinsics(intrinsics, size, name)
    pose = _matrix(world_from_cam, 4, f"{name}: the pose")
    check_pose(pose, name)
    # OpenCV counts pixel centres at integers; ours lie at halves.
    return Frame(name, size, intrinsics + HALF_PIXEL, pose, load_image=partial(np.copy, image))


def _matrix(values: Any, side: int, item: str) -> np.ndarray:
    try:
        matrix = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{item} are not numbers ({error}); give {side} x {side}.") from error
    if matrix.shape != (side, side):
        raise InputError(f"{item} has shape {matrix.shape}; give {side} x {side}.")
    return matrix
