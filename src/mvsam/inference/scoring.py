"""`metrics.json`: the written maps against the scene's ground truth, under the paper's protocol.

The files are scored, not the tensors they came from: a folder that took several runs gets the
scores of one, and they hold for what a user finds in it: where photos corrected each other they are
better than those of one tuple at a time (`mvsam eval`). Millimetre steps change Rel by less than
0.0001.
"""

from collections.abc import Iterable

import numpy as np
import torch
from PIL import Image

from mvsam.data.dataset import make_targets
from mvsam.data.transforms import resize_nearest
from mvsam.evaluation.evaluate import SceneScores, Scores, score_depth
from mvsam.evaluation.metrics import ConfusionMatrix
from mvsam.evaluation.protocols import PROTOCOLS, Protocol
from mvsam.files import write_json
from mvsam.geometry.depth_map import from_millimetres
from mvsam.inference.outputs import OutputFolder
from mvsam.types import Frame


def score_folder(
    folder: OutputFolder, scene_name: str, frames: Iterable[Frame], num_classes: int | None
) -> Scores | None:
    """Scores of the finished photos among `frames`; None, and no file, without ground truth.

    `num_classes` is None where the scene's classes are not the model's; depth alone counts then.
    """
    protocol = PROTOCOLS["paper"]
    photos = [
        _score_photo(folder, frame, protocol, num_classes)
        for frame in frames
        if folder.is_done(frame.name) and _has_truth(frame)
    ]
    if not photos:
        (folder.path / "metrics.json").unlink(missing_ok=True)
        return None
    scores = Scores(protocol.name, {scene_name: sum(photos, SceneScores())})
    write_json(folder.path / "metrics.json", scores.as_json())
    return scores


def _has_truth(frame: Frame) -> bool:
    return frame.load_depth is not None or frame.load_labels is not None


def _score_photo(
    folder: OutputFolder, frame: Frame, protocol: Protocol, num_classes: int | None
) -> SceneScores:
    targets = make_targets(frame, protocol.truth_size)

    def written(kind: str) -> np.ndarray:
        with Image.open(folder.file(kind, frame.name)) as picture:
            return resize_nearest(np.asarray(picture), protocol.truth_size)

    scores = {}
    if "depth" in folder.kinds:
        depth = torch.from_numpy(from_millimetres(written("depth")))
        confidence = None
        if "confidence" in folder.kinds:
            confidence = torch.from_numpy(written("confidence").astype(np.float32))
        scores |= score_depth(depth, confidence, targets.depth[0], protocol)
    if "labels" in folder.kinds and num_classes is not None:
        labels = torch.from_numpy(written("labels").astype(np.int64))
        scores["labels"] = ConfusionMatrix.of_labels(labels, targets.labels[0], num_classes)
    return SceneScores(1, **scores)
