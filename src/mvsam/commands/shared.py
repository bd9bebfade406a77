"""What several verbs need: a model on a device, a progress bar, JSON for scripts."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from mvsam.errors import InputError

if TYPE_CHECKING:
    from rich.progress import Progress

    from mvsam.data.depth_range import DepthRangeOrAuto
    from mvsam.data.formats import Poses
    from mvsam.types import Model, Scene

Device = Literal["auto", "cpu", "cuda"]
"""auto: a GPU where there is one."""

Scale = Annotated[
    float | str,
    tyro.conf.arg(
        metavar="METRES|A:B=METRES",
        help="Metres that one unit of the poses has, as 0.31; or the measured metres between the "
        "cameras of two photos, as 0001.jpg:0007.jpg=0.25, from which that follows. COLMAP's unit "
        "is arbitrary.",
    ),
]

Json = Annotated[bool, tyro.conf.arg(help="Print one JSON document to stdout, for scripts.")]


def load_model(name: str, device: Device) -> Model:
    """The model of a name, path or hub id, on the device."""
    from mvsam import weights
    from mvsam.device import find_device

    target = find_device(device)
    return weights.load(name).to(target)


def open_scenes(
    name: str,
    format: str | None,
    *,
    scale: float | str,
    poses: Poses,
    tuples: str | None,
    num_views: int,
    depth_range: DepthRangeOrAuto,
) -> Sequence[Scene]:
    """`open_data`, then the tuples of a rule or file (`view_rules.prescribe`) where one is named.

    Refined are then the poses of the photos in them alone: of a recording not all can be matched.
    """
    from mvsam.data.catalog import open_data
    from mvsam.data.lazy import changed
    from mvsam.data.refined import RefinedScene
    from mvsam.data.view_rules import prescribe

    if tuples is None:
        return open_data(name, format, scale=scale, poses=poses)
    is_refined = poses == "refined"
    scenes = open_data(name, format, scale=scale, poses="given" if is_refined else poses)
    scenes = prescribe(scenes, tuples, num_views, depth_range)
    return changed(scenes, RefinedScene) if is_refined else scenes


def for_each_scene(scenes: Sequence[Scene], work: Callable[[Scene], None]) -> InputError | None:
    """Does the work with every scene, printing the InputError of one that fails.

    Returns what to raise in the end where some failed. A lone scene's error is raised at once.
    """
    failed = 0
    for index in range(len(scenes)):
        try:
            work(scenes[index])
        except InputError as error:
            if len(scenes) == 1:
                raise
            print(f"error: {error}\n", file=sys.stderr)
            failed += 1
    return (
        InputError(f"{failed} of {len(scenes)} scenes failed, as said above.") if failed else None
    )


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A progress bar on stderr; stdout is for results."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        yield progress


def print_json(value: Any) -> None:
    """One JSON document on stdout."""
    json.dump(value, sys.stdout, indent=2)
    sys.stdout.write("\n")


def print_table(table: Any) -> None:
    """A rich table on stdout, as wide as the terminal."""
    from rich.console import Console

    Console(width=None if sys.stdout.isatty() else 120).print(table)
