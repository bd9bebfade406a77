"""`run.json`: what made the files of an output folder, and what it cost."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from mvsam.data.sampling import ViewTuple
from mvsam.device import device_of
from mvsam.errors import InputError
from mvsam.memory import peak_memory
from mvsam.precision import Precision, resolve
from mvsam.provenance import device_name, versions
from mvsam.types import Frame, Model

IDENTITY = (
    *("scene", "cameras_hash", "model", "weights_hash", "values_hash", "num_views"),
    *("depth_range", "size", "tuples_hash", "precision", "fuse"),
)
"""Keys in which two runs must agree to share a folder."""
_OF_EARLIER_VERSIONS = {"fuse": False}
"""What runs did that do not say."""
_DIFFERENCES = {
    "cameras_hash": "of other cameras",
    "weights_hash": "of other weights",
    "values_hash": "of other weights, or of an earlier version of mvsam",
    "size": "with another --size, or by an earlier version of mvsam",
    "fuse": "for which --alone was chosen otherwise",
    "tuples_hash": "made from other view tuples (--tuples, or the scene's views.txt)",
}


def describe_run(
    model: Model,
    scene_name: str,
    frames: Sequence[Frame],
    num_views: int,
    tuples: Sequence[ViewTuple],
    depth_range: tuple[float, float],
    size: tuple[int, int],
    precision: Precision,
    fuse: bool,
    arguments: dict[str, Any] | None,
) -> dict[str, Any]:
    """The part of `run.json` that is known before the work begins; tuples: all of the scene's."""
    values = hash_of_values(model)
    return {
        "scene": scene_name,
        "cameras_hash": hash_of_cameras(frames),
        "model": model_name(model),
        "weights_hash": model.weights_hash or values,
        "values_hash": values,
        "num_views": num_views,
        "tuples_hash": hash_of_tuples(tuples),
        "depth_range": list(depth_range),
        "size": list(size),
        "precision": resolve(precision, device_of(model).type),
        "fuse": fuse,
        "arguments": arguments or {},
        "versions": versions(),
        "device": _device(model),
    }


def is_same_run(now: dict[str, Any], before: dict[str, Any]) -> bool:
    """Whether two runs may share a folder."""
    before = _OF_EARLIER_VERSIONS | before
    return all(before.get(key) == now[key] for key in IDENTITY)


def check_same_run(now: dict[str, Any], before: dict[str, Any], folder: Path) -> None:
    """Raises `InputError` where a folder holds predictions of another model, scene or setting."""
    before = _OF_EARLIER_VERSIONS | before
    for key in IDENTITY:
        if before.get(key) != now[key]:
            with_another = _DIFFERENCES.get(key, f"with {key} {before.get(key)}, not {now[key]}")
            raise InputError(
                f"{folder} holds predictions {with_another}: choose another --out, or add "
                "--overwrite to replace them."
            )


def describe_cost(seconds: dict[str, float], photos: int) -> dict[str, Any]:
    """The part of `run.json` that is known afterwards."""
    return {
        "photos_predicted": photos,
        "seconds": {stage: round(value, 3) for stage, value in seconds.items()},
        "peak_memory_mb": peak_memory_mb(),
    }


def model_name(model: Model) -> str:
    """The name its weights file gives it, or its class's."""
    return model.info.model if model.info else type(model).__name__


def hash_of_cameras(frames: Sequence[Frame]) -> str:
    """16 digits for the photos' names, sizes, intrinsics and poses: a corrected pose shows."""
    digest = hashlib.sha256()
    for frame in frames:
        digest.update(f"{frame.name} {frame.size}".encode())
        for matrix in (frame.intrinsics, frame.world_from_cam):
            digest.update(np.ascontiguousarray(matrix, dtype=np.float64).tobytes())
    return digest.hexdigest()[:16]


def hash_of_tuples(tuples: Sequence[ViewTuple]) -> str:
    """16 digits for which photos are seen together."""
    return hashlib.sha256(repr([tuple(views) for views in tuples]).encode()).hexdigest()[:16]


def hash_of_values(model: nn.Module) -> str:
    """16 digits of SHA-256 for all numbers of a model, which may have changed in memory.

    And for what it prints as: versions of mvsam may do other things with the same numbers.
    """
    digest = hashlib.sha256(repr(model).encode())
    for name, value in sorted(model.state_dict().items()):
        digest.update(name.encode())
        # As bytes, because NumPy has no bfloat16.
        digest.update(value.detach().cpu().contiguous().flatten().view(torch.uint8).numpy())
    return digest.hexdigest()[:16]


def _device(model: Model) -> str:
    """The GPU's name, or the processor's and the number of threads."""
    device = device_of(model)
    threads = "" if device.type == "cuda" else f" ({torch.get_num_threads()} threads)"
    return device_name(device) + threads


def peak_memory_mb() -> dict[str, float]:
    """Most memory this process had so far: "ram", and "gpu" where one was used."""
    peak = {"ram": round(peak_memory("cpu") / 1e6, 1)}
    if torch.cuda.is_available():
        peak["gpu"] = round(peak_memory("cuda") / 1e6, 1)
    return peak
