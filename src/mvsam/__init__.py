"""Metric depth and semantic maps from a few posed photographs of a room.

    model = mvsam.load("tiny")
    photos = mvsam.predict(model, images, intrinsics, world_from_cam)
    photos[0].depth, photos[0].labels

Names are looked up when first used, so `import mvsam` is quick.
"""

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mvsam.data.formats import open_scene
    from mvsam.inference.outputs import PhotoPrediction
    from mvsam.inference.photos import predict, refine_poses
    from mvsam.types import Frame, Prediction, Scene, Targets, Views
    from mvsam.weights import from_pretrained, load, push_to_hub, save

__version__ = version("mvsam")

_HOMES = {
    "Frame": "mvsam.types",
    "PhotoPrediction": "mvsam.inference.outputs",
    "Prediction": "mvsam.types",
    "Scene": "mvsam.types",
    "Targets": "mvsam.types",
    "Views": "mvsam.types",
    "from_pretrained": "mvsam.weights",
    "load": "mvsam.weights",
    "open_scene": "mvsam.data.formats",
    "predict": "mvsam.inference.photos",
    "push_to_hub": "mvsam.weights",
    "refine_poses": "mvsam.inference.photos",
    "save": "mvsam.weights",
}

__all__ = [
    "Frame",
    "PhotoPrediction",
    "Prediction",
    "Scene",
    "Targets",
    "Views",
    "from_pretrained",
    "load",
    "open_scene",
    "predict",
    "push_to_hub",
    "refine_poses",
    "save",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'mvsam' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
