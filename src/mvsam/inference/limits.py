"""How much memory predicting takes, counted on shapes alone, and how to stay below a limit."""

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.multiprocessing.reductions import StorageWeakRef
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from mvsam.errors import InputError
from mvsam.types import EncodesViews, Model, Views

REMEMBERED_PHOTOS = 24
"""Encoded photos kept at once; those of `base` take about 11 MB each."""

BYTES_PER_PIXEL = 60
"""What the photos' own size costs for each of their pixels: of 12 megapixels, reading took 14 and
the maps of another took 36; the rest is for writing."""


@dataclass(frozen=True)
class Needs:
    """Bytes that a prediction takes besides the program and the weights."""

    encode: int
    """While one photo is encoded; a model that is only called as a whole has none of this."""
    photo: int
    """What is kept of an encoded photo."""
    decode: int
    """While one reference is decoded."""
    pictures: int
    """For the photo that is read meanwhile, and maps of a photo's size."""

    def total(self, remembered_photos: int) -> int:
        at_work = max(self.encode, self.decode)
        return remembered_photos * self.photo + at_work + self.pictures


def photos_within(limit: int, used: int, needs: Needs, num_views: int) -> int:
    """How many encoded photos to remember within `limit` bytes, of which `used` are taken already.

    At most `REMEMBERED_PHOTOS`, at least those of one tuple: with fewer, photos are encoded more
    often, to the same result. Raises `InputError` with the least limit that is possible.
    """
    for photos in range(REMEMBERED_PHOTOS, num_views - 1, -1):
        if used + needs.total(photos) <= limit:
            return photos
    least = used + needs.total(num_views)
    raise InputError(
        f"a memory limit of {_gigabytes(limit)} GB is too little: at least {_gigabytes(least)} GB "
        f"are needed, {_gigabytes(used)} of them for the program and the weights; allow that much, "
        "or ask for fewer views or smaller photos."
    )


def _gigabytes(size: int) -> str:
    """Rounded up, so that the figure suffices when it is given as a limit."""
    return f"{math.ceil(size / 1e7) / 100:.2f}"


def count_needs(model: Model, size: tuple[int, int], num_views: int, pixels_of_photo: int) -> Needs:
    """What a model takes at `size` (width, height): its calls are run on shapes without numbers.

    Every tensor alive counts, in float32. What oneDNN and cuDNN take for themselves does not; a
    plane sweep counts as in its plain form, which takes more than the compiled one. `tiny` with
    three views of 320x256 was counted at 240 MB and took 178 on a CPU.
    """
    shapes = _on_meta(model)
    one, several = _views(model, size, 1), _views(model, size, num_views)
    pictures = BYTES_PER_PIXEL * pixels_of_photo
    with torch.inference_mode():
        if not isinstance(shapes, EncodesViews):
            whole, _ = _peak_bytes(lambda: shapes(several))
            return Needs(0, _bytes(one.images), whole, pictures)
        encode, features = _peak_bytes(lambda: shapes.encode(one))
        photo = _bytes(one.images) + sum(_bytes(t) for t in _tensors(vars(features)))

        def decode() -> Any:
            joined = type(features).join([features] * num_views)
            return shapes.decode(joined, several)

        return Needs(encode, photo, _peak_bytes(decode)[0], pictures)


def _on_meta(model: Model) -> Model:
    """A copy of shapes without numbers."""
    tensors = (*model.parameters(), *model.buffers())
    return copy.deepcopy(model, {id(tensor): _shape_of(tensor) for tensor in tensors}).eval()


def _shape_of(tensor: Tensor) -> Tensor:
    shape = torch.empty_like(tensor, device="meta")
    return nn.Parameter(shape, False) if isinstance(tensor, nn.Parameter) else shape


def _views(model: Model, size: tuple[int, int], num_views: int) -> Views:
    width, height = size
    semantic_size = model.semantic_size
    with torch.device("meta"):
        return Views(
            images=torch.empty(1, num_views, 3, height, width),
            intrinsics=torch.empty(1, num_views, 3, 3),
            world_from_cam=torch.empty(1, num_views, 4, 4),
            depth_range=torch.empty(1, 2),
            measured_depth=torch.empty(1, height, width),
            semantic_images=torch.empty(1, num_views, 3, *semantic_size[::-1])
            if semantic_size
            else None,
        )


def _tensors(values: Any) -> list[Tensor]:
    return [leaf for leaf in tree_leaves(values) if isinstance(leaf, Tensor)]


def _bytes(tensor: Tensor) -> int:
    return tensor.numel() * tensor.element_size()


def _peak_bytes(call: Callable[[], Any]) -> tuple[int, Any]:
    """(most bytes alive at once among the tensors that `call` makes, its result)."""
    with _Ledger() as ledger:
        result = call()
    return ledger.peak, result


class _Ledger(TorchDispatchMode):
    """Adds up the storages that operations make, for as long as something holds them."""

    def __init__(self):
        super().__init__()
        self.peak = 0
        self._alive: dict[int, tuple[StorageWeakRef, int]] = {}

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        given = {t.untyped_storage()._cdata for t in _tensors((args, kwargs)) if t.is_meta}
        result = func(*args, **(kwargs or {}))
        for tensor in _tensors(result):
            storage = tensor.untyped_storage()
            if storage._cdata not in given:
                self._alive[storage._cdata] = (StorageWeakRef(storage), storage.nbytes())
        self._alive = {key: entry for key, entry in self._alive.items() if not entry[0].expired()}
        self.peak = max(self.peak, sum(size for _, size in self._alive.values()))
        return result
