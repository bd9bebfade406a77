"""`mvsam eval`."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from mvsam.commands.shared import (
    Device,
    Json,
    Scale,
    load_model,
    open_scenes,
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
    """rooms:val, rooms:test, a part (rooms:val:0-10), the path of one scene or of several, or of a
    list of scenes beside them (scannetv2_val.txt)."""
    format: str | None = None
    """Format of a scene's folder; found from its files where it is not given."""
    scale: Scale = 1.0
    poses: Literal["given", "refined"] = "given"
    """refined: let the photos correct the given ones first, which trackers have wrong by half a
    degree and some centimetres; seconds for a few photos, and no more than 150 of a scene. Of a
    recording name its --tuples. Where neither they nor the scene say which photos go together,
    other poses may choose others."""
    protocol: str = "paper"
    """Which pixels count, at which size. paper: 320x256, truth in [0.1, 5] m. mvs2d: MVS2D's own,
    640x480 and (0.5, 10) m, searching 0.3 to 10.1 m. scannet-2d: the 2D benchmark's labels at
    640x480. half: as paper, at 160x128. real: as paper, at most 24 view tuples a scene."""
    views: int | None = None
    """Photos that are looked at together; the protocol's number where it is not given."""
    tuples: str | None = None
    """Which photos go together: mvs2d (every 20th frame and its neighbours), every-100 (references
    as in ScanNet's 2D benchmark), keyframes, or a file (MVS2D's .npy); where it is not given, the
    scene's own tuples, else those that overlap best."""
    depth_range: tuple[float, float] | None = None
    """Metres between which the network looks for surfaces; the protocol's where it is not given.
    Which pixels count stays the protocol's."""
    size: tuple[int, int] | None = None
    """Width and height at which the network sees the photos, as in mvsam predict; the protocol's
    where they are not given. Scores are taken at the protocol's size."""
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
        from mvsam.device import device_of
        from mvsam.evaluation.evaluate import evaluate
        from mvsam.inference.photos import check_size
        from mvsam.inference.reading import one_ahead
        from mvsam.precision import resolve
        from mvsam.provenance import provenance

        protocol = _protocol(self.protocol)
        check_size(self.size)
        if self.limit is not None and self.limit < 1:
            raise InputError(f"--limit {self.limit}: give 1 or more view tuples.")
        model = load_model(_weights_of(self.model), self.device)
        samples = self._samples(protocol, model)
        chosen = evenly_spaced(range(len(samples)), self.limit)
        if model.reads_depth and chosen and samples[0][1].measured_depth is None:
            raise InputError(
                f"{self.data}: its first photo has no measured depth, which {self.model} reads; "
                "choose a model of RGB views (mvsam models)."
            )
        if not samples.has_truth():
            raise InputError(
                f"{self.data}: no depth or labels to score {self.model} by; name data with ground "
                "truth."
            )
        with progress_bar() as progress:
            task = progress.add_task(f"evaluate {self.model}", total=len(chosen))
            scores = evaluate(
                fold_batch_norm(model),
                one_ahead(samples[index] for index in chosen),
                protocol,
                lambda done: progress.update(task, completed=done),
                self.precision,
            )
        if self.json:
            device = device_of(model)
            measured = {
                "model": self.model,
                "weights_hash": model.weights_hash,
                "data": self.data,
                "num_views": samples.num_views,
                "size": samples.size,
                "depth_range": samples.depth_range,
                "poses": self.poses,
                "scale": self.scale,
                "tuples": self.tuples,
                "limit": self.limit,
                "precision": resolve(self.precision, device.type),
            }
            print_json(measured | provenance(device) | scores.as_json())
        else:
            print_table(scores.as_table())

    def _samples(self, protocol: Protocol, model: Model) -> TupleDataset:
        from mvsam.data.dataset import TupleDataset
        from mvsam.data.depth_range import checked_depth_range
        from mvsam.data.labels import classes_of_model
        from mvsam.data.lazy import changed
        from mvsam.data.wrapped import LabelsOf
        from mvsam.inference.photos import fewest_views

        num_views = protocol.num_views if self.views is None else self.views
        if num_views < fewest_views(model):
            raise InputError(
                f"--views {num_views}: {self.model} looks at {fewest_views(model)} photos or more."
            )
        depth_range = checked_depth_range(
            self.depth_range or protocol.search_range or protocol.depth_range
        )
        scenes = open_scenes(
            self.data,
            self.format,
            scale=self.scale,
            poses=self.poses,
            tuples=self.tuples,
            num_views=num_views,
            depth_range=depth_range,
        )
        classes = classes_of_model(model)
        samples = TupleDataset(
            changed(scenes, partial(LabelsOf, classes=classes)),
            num_views=num_views,
            size=self.size or protocol.size,
            depth_range=depth_range,
            tuples_per_scene=protocol.tuples_per_scene,
            semantic_size=model.semantic_size,
            truth_size=protocol.truth_size,
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
