"""`mvsam export`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mvsam.commands.shared import load_model
from mvsam.errors import InputError


@dataclass(frozen=True)
class Export:
    """The whole network as one file that runs without torch.

    Cameras and depth range are inputs of it. It takes 2 to 8 photos (a model of one view takes
    one) of the size that is given here. docs/export.md lists inputs and outputs.

    Example: mvsam export tiny --out tiny.onnx
    """

    model: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="MODEL")]
    """Name with embedded weights, path of a .safetensors or .ckpt file, or Hugging Face id."""
    out: Path
    """The file."""
    format: Literal["onnx"] = "onnx"
    """Format of the file."""
    size: tuple[int, int] | None = None
    """Width and height of the photos it will take, multiples of 32; the model's own where they are
    not given."""

    def run(self) -> None:
        from mvsam.inference.onnx import export_onnx

        if self.out.suffix != f".{self.format}":
            raise InputError(f"{self.out} must end in .{self.format}.")
        model = load_model(self.model, "cpu")
        width, height = self.size or model.input_size
        export_onnx(model, self.out, (width, height))
        print(f"{self.out}: {self.model} for photos of {width}x{height}")
