"""Predicted maps made better by those of neighbouring photos, in memory or in an output folder."""

from collections.abc import Sequence

from mvsam.data.labels import ClassTable
from mvsam.inference.outputs import OutputFolder, PhotoPrediction
from mvsam.reconstruction.fusion import PhotoMaps, corrections
from mvsam.reconstruction.thinning import ThinnedCamera, thin
from mvsam.types import Frame

LONGEST_SIDE = 320
"""Pixels; maps are compared at no more. One and its correction take 1 MB of memory."""


def fuse_predictions(
    frames: Sequence[Frame], predictions: Sequence[PhotoPrediction]
) -> list[PhotoPrediction]:
    """Predictions of photos of one scene; the maps of each heed the others.

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
        PhotoPrediction(*correction.applied(own))
        for own, correction in zip(maps, corrections(cameras, thinned), strict=True)
    ]


def fuse_folder(folder: OutputFolder, frames: Sequence[Frame], classes: ClassTable) -> None:
    """Makes the maps of all photos that are done heed each other.

    The photos' own stay beside them, so that after a photo was added, or an interruption, the same
    call ends with the same maps. Does nothing where the model gives no depth or no confidence.
    """
    if not {"depth", "confidence"} <= set(folder.kinds):
        return
    done = [frame for frame in frames if folder.is_done(frame.name)]
    if len(done) < 2:
        return
    cameras = [_thinned_camera(frame) for frame in done]
    thinned = [
        _thinned(folder.maps(frame.name, own=True), camera)
        for frame, camera in zip(done, cameras, strict=True)
    ]
    for frame, correction in zip(done, corrections(cameras, thinned), strict=True):
        better = correction.applied(folder.maps(frame.name, own=True))
        folder.write_better(frame.name, better, classes)


def _thinned_camera(frame: Frame) -> ThinnedCamera:
    return thin(frame.size, frame.intrinsics, frame.world_from_cam, LONGEST_SIDE)


def _thinned(own: PhotoMaps, camera: ThinnedCamera) -> PhotoMaps:
    labels = None if own.labels is None else camera.thinned(own.labels)
    return PhotoMaps(camera.thinned(own.depth), camera.thinned(own.confidence), labels)
