"""A model at work on the photos of one scene: each photo is read and encoded once.

References are decoded one by one: three in one batch took 1.3 times as long on a CPU (docs/log.md).
"""

import time
from collections import OrderedDict, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import Any

import torch

from mvsam.convolution import fold_batch_norm
from mvsam.data.dataset import make_views
from mvsam.device import device_of
from mvsam.inference.limits import REMEMBERED_PHOTOS
from mvsam.inference.outputs import PhotoPrediction
from mvsam.inference.reading import PhotoReader
from mvsam.inference.upsampling import depth_at_size, labels_at_size, smooth_at_size
from mvsam.precision import Precision, autocast
from mvsam.types import EncodesViews, Frame, Model, Prediction, Views


class Stopwatch:
    """Seconds spent in each named stage on a device, whose work is waited for."""

    def __init__(self, device: torch.device):
        self.device = device
        self.seconds: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        self.seconds[stage] += time.perf_counter() - start


@dataclass(frozen=True)
class EncodedPhoto:
    """One photo at the network's size, and what the encoders say about it."""

    views: Views
    """A batch of one with one view."""
    features: Any
    """What `model.encode` returns; None for a model that is only called as a whole."""


class Session:
    """Runs a model on tuples of frames, remembering the photos it saw last.

    A model with `encode` and `decode` encodes each photo once; any other is called as a whole.
    `size` (width, height) is what it sees photos at; None: `model.input_size`.
    Frames are told apart by name. The model stays as it was; weights that change later do not count
    here (`fold_batch_norm`). As a context manager a session ends its reading thread.
    """

    def __init__(
        self,
        model: Model,
        depth_range: tuple[float, float],
        remembered_photos: int = REMEMBERED_PHOTOS,
        precision: Precision = "auto",
        size: tuple[int, int] | None = None,
    ):
        self.model = fold_batch_norm(model)
        self.depth_range = depth_range
        self.precision: Precision = precision
        self.size = size or model.input_size
        self.device = device_of(model)
        self._encoder = self.model if isinstance(self.model, EncodesViews) else None
        self.stopwatch = Stopwatch(self.device)
        self._reader = PhotoReader(self._read)
        self._encoded: OrderedDict[str, EncodedPhoto] = OrderedDict()
        self._remembered_photos = remembered_photos

    def __enter__(self) -> "Session":
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.close()

    def predict_all(self, tuples: Iterable[Sequence[Frame]]) -> Iterator[PhotoPrediction]:
        """Depth, confidence and labels of each tuple's first frame, at its photo's size, in order.

        While the model is at work on one tuple, the photos of the next one are read (the stopwatch
        counts the waiting).
        """
        for frames, following in pairwise(chain(tuples, [()])):
            soon = (*frames, *following)
            self._reader.announce(frame for frame in soon if frame.name not in self._encoded)
            yield self.predict(frames)

    def predict(self, frames: Sequence[Frame]) -> PhotoPrediction:
        """Depth, confidence and labels of the first frame, at its photo's size."""
        with torch.inference_mode(), autocast(self.device.type, self.precision):
            photos = [self._encode(frame) for frame in frames]
            with self.stopwatch("decode"):
                prediction = self._decode(photos)
            with self.stopwatch("resize"):
                return _at_photo_size(prediction, frames[0].size)

    def _encode(self, frame: Frame) -> EncodedPhoto:
        if frame.name in self._encoded:
            self._encoded.move_to_end(frame.name)
            return self._encoded[frame.name]
        with self.stopwatch("read"):
            views = self._reader.take(frame).to(self.device)
        with self.stopwatch("encode"):
            features = None if self._encoder is None else self._encoder.encode(views)
        while len(self._encoded) >= self._remembered_photos:
            self._encoded.popitem(last=False)
        views = replace(views, semantic_images=None)  # large, and encoded by now
        self._encoded[frame.name] = EncodedPhoto(views, features)
        return self._encoded[frame.name]

    def _read(self, frame: Frame) -> Views:
        if not self.model.reads_depth:
            frame = replace(frame, load_depth=None)
        return make_views([frame], self.size, self.depth_range, self.model.semantic_size)

    def _decode(self, photos: list[EncodedPhoto]) -> Prediction:
        """The model's word on the first photo."""
        views = _side_by_side([photo.views for photo in photos])
        if self._encoder is None:
            return self.model(views)
        parts = [photo.features for photo in photos]
        return self._encoder.decode(type(parts[0]).join(parts), views)


def _side_by_side(parts: Sequence[Views]) -> Views:
    """Views of one place joined; the measured depth is the first one's."""
    return replace(
        parts[0],
        images=torch.cat([part.images for part in parts], dim=1),
        intrinsics=torch.cat([part.intrinsics for part in parts], dim=1),
        world_from_cam=torch.cat([part.world_from_cam for part in parts], dim=1),
    )


def _at_photo_size(prediction: Prediction, size: tuple[int, int]) -> PhotoPrediction:
    depth, confidence, logits = prediction.depth, prediction.confidence, prediction.logits
    return PhotoPrediction(
        depth=None if depth is None else depth_at_size(depth[0].float(), size).cpu().numpy(),
        confidence=None
        if confidence is None
        else smooth_at_size(confidence[0].float(), size).clamp(0, 1).cpu().numpy(),
        labels=None if logits is None else labels_at_size(logits[0].float(), size).cpu().numpy(),
    )
