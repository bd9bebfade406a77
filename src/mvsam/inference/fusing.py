"""Predicted maps made better by those of neighbouring photos, in memory or in an output folder."""

import logging
from collections.abc import Sequence

from mvsam.data.labels import ClassTable
from mvsam.inference.outputs import OutputFolder, PhotoPrediction
from mvsam.reconstruction.fusion import PhotoMaps, corrections
from mvsam.reconstruction.thinning import ThinnedCamera, thin
from mvsam.types import Frame

log = logging.getLogger("mvsam")

LONGEST_SIDE = 320
"""Pixels; maps are compared at no more. Those of a photo and their correction take 2 MB."""
FARTHEST_IN_PNG = 65.5
"""Metres; what a depth PNG holds beyond may be farther than it says."""


def fuse_predictions(
    frames: Sequence[Frame], predictions: Sequence[PhotoPrediction]
) -> list[PhotoPrediction]:
    """Predictions of photos of one scene, whose maps correct each other.

    As they are where the model gives no depth, or no confidence to weigh it by.
    """
    maps = [
        PhotoMaps(prediction.depth, prediction.confidence, prediction.labels)
        for prediction in predictions
        if prediction.depth is not None and prediction.confidence is not None
    ]
    if len(maps) < len(predictions):
        return list(predictions)
    cameras = [_thinned_camera(frame) for frame in frames]
    thinned = [_thinned(own, camera) for own, camera in zip(maps, cameras, strict=True)]
    return [
        PhotoPrediction(*correction.applied(own, camera))
        for own, camera, correction in zip(
            maps, cameras, corrections(cameras, thinned), strict=True
        )
    ]


def fuse_folder(folder: OutputFolder, frames: Sequence[Frame], classes: ClassTable) -> bool:
    """Lets the maps of all photos that are done correct each other; False where none can.

    The network's own stay in `own/`, so that after a photo was added, or an interruption, the same
    call ends with the same maps. Photos can where there are two, with depth and confidence.
    """
    done = [frame for frame in frames if folder.is_done(frame.name)]
    if len(done) < 2 or not {"own_depth", "own_confidence"} <= set(folder.kinds):
        return False
    log.info("the maps of %d photos correct each other", len(done))
    cameras = [_thinned_camera(frame) for frame in done]
    thinned = [
        _thinned(folder.own_maps(frame.name), camera)
        for frame, camera in zip(done, cameras, strict=True)
    ]
    found = corrections(cameras, thinned)
    for frame, camera, correction in zip(done, cameras, found, strict=True):
        better = correction.applied(folder.own_maps(frame.name), camera)
        folder.replace_maps(frame.name, better, classes)
    return True


def _thinned_camera(frame: Frame) -> ThinnedCamera:
    return thin(frame.size, frame.intrinsics, frame.world_from_cam, LONGEST_SIDE)


def _thinned(own: PhotoMaps, camera: ThinnedCamera) -> PhotoMaps:
    labels = None if own.labels is None else camera.thinned(own.labels)
    depth = camera.thinned(own.depth)
    depth[depth > FARTHEST_IN_PNG] = 0
    return PhotoMaps(depth, camera.thinned(own.confidence), labels)
