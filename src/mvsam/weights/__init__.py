"""Weights in and out: safetensors beside a JSON page, the Hugging Face hub, SAM's own files.

No file can run code: `.safetensors` holds numbers only, `.pth` and `.ckpt` are read with
`weights_only=True`.
"""

from mvsam.weights.files import (
    ASSETS,
    embedded,
    from_pretrained,
    load,
    load_encoder,
    load_into,
    locate,
    save,
)
from mvsam.weights.hub import push_to_hub
from mvsam.weights.page import HUB_PAGE, HUB_WEIGHTS, RUN_PAGE, WeightsInfo, read_info
from mvsam.weights.sam import load_sam
from mvsam.weights.tensors import file_hash, layout_channels_last, read_tensors

__all__ = [
    "ASSETS",
    "HUB_PAGE",
    "HUB_WEIGHTS",
    "RUN_PAGE",
    "WeightsInfo",
    "embedded",
    "file_hash",
    "from_pretrained",
    "layout_channels_last",
    "load",
    "load_encoder",
    "load_into",
    "load_sam",
    "locate",
    "push_to_hub",
    "read_info",
    "read_tensors",
    "save",
]
