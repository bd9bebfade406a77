"""Named tensors from files, checked against a model, and their layout in memory."""

import hashlib
import pickle
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from mvsam.errors import InputError

AnyModule = TypeVar("AnyModule", bound=nn.Module)


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Named float32 tensors of a weights file; InputError if it is corrupt or could run code."""
    try:
        if path.suffix == ".safetensors":
            tensors = load_file(path)
        else:
            tensors = _model_entries(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:  # a broken pickle can end in any exception there is
        raise InputError(
            f"{path}: not a readable weights file (truncated, corrupt, or it holds more than "
            f"numbers): {type(error).__name__}."
        ) from error
    return {k: v.float() if v.is_floating_point() else v for k, v in tensors.items()}


def _model_entries(checkpoint: Any) -> dict[str, Tensor]:
    """The tensors of a plain state dict, or those of the model in a Lightning checkpoint."""
    if isinstance(checkpoint, dict) and "state_dict" in checkpoint:
        entries = checkpoint["state_dict"]
        return {k.removeprefix("model."): v for k, v in entries.items() if k.startswith("model.")}
    if isinstance(checkpoint, dict) and all(isinstance(v, Tensor) for v in checkpoint.values()):
        return checkpoint
    raise pickle.UnpicklingError("no tensors by name")


def load_strictly(module: nn.Module, tensors: dict[str, Tensor], path: Path) -> None:
    """Loads all of `tensors` into all of `module`; InputError says what does not fit."""
    own = module.state_dict()
    missing, unknown = sorted(set(own) - set(tensors)), sorted(set(tensors) - set(own))
    misshapen = sorted(k for k in set(own) & set(tensors) if own[k].shape != tensors[k].shape)
    problems = {"missing": missing, "unknown": unknown, "of another shape": misshapen}
    said = [f"{len(v)} {k} (first: {v[0]})" for k, v in problems.items() if v]
    if said:
        raise InputError(f"{path} does not fit this model: {'; '.join(said)}.")
    module.load_state_dict(tensors)


def file_hash(path: Path) -> str:
    """First 16 digits of the file's SHA-256."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def layout_channels_last(model: AnyModule) -> AnyModule:
    """The same model, convolution weights in channels-last order: faster on CPUs and GPUs."""
    for module in model.modules():
        if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
            module.to(memory_format=torch.channels_last)
        elif isinstance(module, nn.Conv3d | nn.ConvTranspose3d):
            module.to(memory_format=torch.channels_last_3d)
    return model
