"""`mvsam eval`."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mvsam.commands.shared import (
    Device,
    Json,
    load_model,
    print_json,
    print_table,
    progress_bar,
)
from mvsam.errors import InputError

if TYPE_CHECKING:
    from mvsam.data.dataset import TupleDataset
    from mvsam.evaluation.protocols import Protocol
    from mvsam.types import Model

log = logging.getLogger("mvsam")


@dataclass(frozen=True)
class Evaluate:
    """Scores of a model on data with ground truth, under a named protocol.

    Abs and RMSE are metres, Rel, deltas and mIoU fractions in --json; the table shows centimetres
    and percent.

    Example: mvsam eval tiny --data rooms:val --protocol paper
    """

    model: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="MODEL")]
    """Name with embedded weights, name of a finished run, path of a .safetensors or .ckpt file, or
    Hugging Face id."""
    data: str = "rooms:val"
    """rooms:val, rooms:test, a part (rooms:val:0-10), or the path of one scene or of several."""
    format: str | None = None
    """Format of a scene's folder; found from its files where it is not given."""
    scale: float = 1.0
    """Metres that one unit of the poses has."""
    protocol: str = "paper"
    """Which pixels count, at which size: paper, half or real."""
    views: int | None = None
    """Photos that are looked at together; the protocol's number where it is not given."""
    limit: int | None = None
    """At most so many view tuples altogether, evenly spaced."""
    json: Json = False
    device: Device = "auto"
    """Where the network runs; auto takes a GPU where there is one."""
    precision: Literal["auto", "float32", "bfloat16"] = "auto"
    """auto: bfloat16 where the device multiplies it natively; elsewhere it would be slower."""

    def run(self) -> None:
        from mvsam.convolution import fold_batch_norm
        from mvsam.data.sampling import evenly_spaced
        from mvsam.evaluation.evaluate import evaluate
        from mvsam.inference.reading import one_ahead
        from mvsam.precision import autocast

        protocol = _protocol(self.protocol)
        model = load_model(_weights_of(self.model), self.device)
        samples = self._samples(protocol, model)
        chosen = evenly_spaced([(index,) for index in range(len(samples))], self.limit)
        device = next(model.parameters()).device.type
        with progress_bar() as progress, autocast(device, self.precision):
            task = progress.add_task(f"evaluate {self.model}", total=len(chosen))
            scores = evaluate(
                fold_batch_norm(model),
                one_ahead(samples[index] for (index,) in chosen),
                protocol,
                lambda done: progress.update(task, completed=done),
            )
        if self.json:
            print_json(scores.as_json())
        else:
            print_table(scores.as_table())

    def _samples(self, protocol: Protocol, model: Model) -> TupleDataset:
        from mvsam.data.catalog import open_data
        from mvsam.data.dataset import TupleDataset

        samples = TupleDataset(
            open_data(self.data, self.format, scale=self.scale),
            num_views=self.views or protocol.num_views,
            size=protocol.size,
            depth_range=protocol.depth_range,
            tuples_per_scene=protocol.tuples_per_scene,
            semantic_size=model.semantic_size,
        )
        for name in samples.skipped:
            log.warning("%s: no other photo overlaps it; it is skipped.", name)
        return samples


def _weights_of(name: str) -> str:
    """The trained weights of a run of that name; else the name itself."""
    from mvsam.weights import embedded

    trained = Path("runs") / name / "model.safetensors"
    return name if name in embedded() or not trained.exists() else str(trained)


def _protocol(name: str) -> Protocol:
    from mvsam.evaluation.protocols import PROTOCOLS

    if name not in PROTOCOLS:
        raise InputError(f"unknown protocol '{name}'; protocols: {', '.join(PROTOCOLS)}.")
    return PROTOCOLS[name]
