"""What a frozen encoder says about a picture, kept on disk: computed once, read ever after."""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from mvsam.errors import InputError
from mvsam.files import read_array, writable_folder, write_whole

FrozenPart = Callable[[Float[Tensor, "images 3 height width"]], Float[Tensor, "images *features"]]


class FeatureCache:
    """One file a picture below `folder`, in float16, of the output of an encoder's frozen part.

    A file is found by the picture's pixels, its size, the arithmetic in use (`torch.autocast`) and
    `identity()`, which stands for the weights and the sizes of the frozen part; it is asked for at
    the first picture, when a resumed training has its weights. SAM's ViT-B at 1024 pixels takes
    2.1 MB a picture where all of it is frozen (256 x 64 x 64) and 6.3 MB where blocks are tuned
    (64 x 64 x 768). Nothing is ever removed. What was just computed passes through float16 too, so
    that the first run equals every later one; files that cannot be read are made anew.
    """

    def __init__(self, folder: Path, identity: Callable[[], str]):
        self.folder = writable_folder(folder)
        self._identity = cache(identity)
        self.hits = 0
        self.misses = 0

    def __call__(
        self, images: Float[Tensor, "images 3 height width"], compute: FrozenPart
    ) -> Float[Tensor, "images *features"]:
        """`compute(images)` in float32; `compute` gets only the pictures that have no file yet."""
        if images.is_meta:  # shapes without numbers (inference/limits.py)
            return compute(images)
        paths = [self._path(image) for image in images]
        found = [_read(path) for path in paths]
        missing = [index for index, features in enumerate(found) if features is None]
        self.hits += len(found) - len(missing)
        self.misses += len(missing)
        if missing:
            for index, features in zip(missing, compute(images[missing]), strict=True):
                found[index] = features = features.detach().half().cpu()
                self._write(paths[index], features)
        # float32 first: autocast does not stack float16 on a CPU.
        wide = [features.float() for features in found if features is not None]
        return torch.stack(wide).to(images.device)

    def _path(self, image: Float[Tensor, "3 height width"]) -> Path:
        device = image.device.type
        is_mixed = torch.is_autocast_enabled(device)
        arithmetic = torch.get_autocast_dtype(device) if is_mixed else torch.float32
        digest = hashlib.sha256(f"{self._identity()} {tuple(image.shape)} {arithmetic} ".encode())
        digest.update(image.detach().float().cpu().contiguous().numpy().data)
        name = digest.hexdigest()
        return self.folder / name[:2] / f"{name}.npz"

    def _write(self, path: Path, features: Tensor) -> None:
        if not features.isfinite().all():
            raise InputError(
                "this encoder's features go beyond what float16 holds: leave the feature cache out."
            )
        write_whole(path, lambda file: np.savez(file, features=features.numpy()))


def _read(path: Path) -> Tensor | None:
    """The features in a file; None where there is none or it is damaged (its checksum says so)."""
    try:
        return torch.from_numpy(read_array(path, "features"))
    except InputError:
        return None


def hash_of_weights(parts: list[nn.Module | Tensor]) -> str:
    """16 digits for all numbers in these parts, in order."""
    digest = hashlib.sha256()
    for part in parts:
        tensors = [part] if isinstance(part, Tensor) else part.state_dict().values()
        for tensor in tensors:
            # As bytes, because NumPy has no bfloat16.
            values = tensor.detach().cpu().contiguous().flatten().view(torch.uint8)
            digest.update(values.numpy().data)
    return digest.hexdigest()[:16]
