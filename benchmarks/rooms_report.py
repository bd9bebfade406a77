"""Rooms beside real photographs: what they show, how far away, and how the views lie.

    python benchmarks/rooms_report.py DATA --rooms 40 --out results/rooms_report.json

DATA is a folder of posed sequences with `views.txt`, and of `nyuv2_train` for the labels. Where the
columns differ, the rooms are to be changed. `mvsam rooms preview` shows pictures of them.
"""

import argparse
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from mvsam.data.catalog import open_data
from mvsam.data.labels import SCANNET20
from mvsam.data.readers.single_views import SingleViews
from mvsam.data.sampling import evenly_spaced, view_tuples
from mvsam.data.transforms import area_resize, resize_intrinsics, resize_nearest
from mvsam.provenance import provenance
from mvsam.types import IGNORE, Frame, Scene

SIZE = (320, 256)
FLAT = 4.0
"""Grey levels between neighbouring pixels; below, stereo has little to go by."""
TUPLES = 8
"""Of each scene at most."""


@dataclass
class Statistics:
    """What was gathered from one kind of data; lengths in metres, angles in degrees."""

    depth: list[np.ndarray] = field(default_factory=list)
    labels: np.ndarray = field(default_factory=lambda: np.zeros(256))
    brightness: list[float] = field(default_factory=list)
    flat: list[float] = field(default_factory=list)
    baseline: list[float] = field(default_factory=list)
    turn: list[float] = field(default_factory=list)
    overlap: list[float] = field(default_factory=list)

    def add_frame(self, frame: Frame) -> None:
        grey = area_resize(frame.image, SIZE).mean(dim=0).numpy() * 255
        across, down = np.abs(np.diff(grey, axis=1))[:-1], np.abs(np.diff(grey, axis=0))[:, :-1]
        self.brightness.append(float(grey.mean()))
        self.flat.append(float((np.maximum(across, down) < FLAT).mean()))
        if (depth := frame.depth) is not None:
            self.depth.append(depth[depth > 0][::17])
        if (labels := frame.labels) is not None:
            self.labels += np.bincount(labels.ravel(), minlength=256)

    def add_pair(self, reference: Frame, source: Frame) -> None:
        here, there = reference.world_from_cam, source.world_from_cam
        turned = (np.trace(here[:3, :3].T @ there[:3, :3]) - 1) / 2
        self.baseline.append(float(np.linalg.norm(here[:3, 3] - there[:3, 3])))
        self.turn.append(float(np.degrees(np.arccos(np.clip(turned, -1, 1)))))
        if reference.depth is not None and source.depth is not None:
            self.overlap.append(overlap(reference, source))

    def as_json(self) -> dict:
        """Percentiles 10, 50 and 90 of each quantity, and each class's share of the pixels."""
        known = self.labels[: len(SCANNET20)]
        shares = known / known.sum() if known.sum() else known
        quantities = {
            "depth": np.concatenate(self.depth) if self.depth else np.empty(0),
            **{name: getattr(self, name) for name in QUANTITIES[1:]},
        }
        return {
            **{name: percentiles(values) for name, values in quantities.items()},
            "unlabelled": float(self.labels[IGNORE] / max(self.labels.sum(), 1)),
            "classes": dict(zip(SCANNET20.names, shares.tolist(), strict=True)),
        }


QUANTITIES = ("depth", "brightness", "flat", "baseline", "turn", "overlap")


def percentiles(values: Sequence[float] | np.ndarray) -> list[float] | None:
    return np.percentile(values, [10, 50, 90]).tolist() if len(values) else None


def overlap(reference: Frame, source: Frame) -> float:
    """Share of the reference's pixels with depth that the source sees, within 5 % of its depth."""
    small = (40, 32)
    depth, other = (
        resize_nearest(f.depth if f.depth is not None else np.zeros(f.size[::-1]), small)
        for f in (reference, source)
    )
    first, second = (resize_intrinsics(f.intrinsics, f.size, small) for f in (reference, source))
    column, row = np.meshgrid(np.arange(small[0]) + 0.5, np.arange(small[1]) + 0.5)
    rays = np.stack([column, row, np.ones_like(column)], axis=-1) @ np.linalg.inv(first).T
    points = (rays * depth[..., None])[depth > 0]
    source_from_reference = np.linalg.inv(source.world_from_cam) @ reference.world_from_cam
    local = points @ source_from_reference[:3, :3].T + source_from_reference[:3, 3]
    pixels = (local @ second.T)[local[:, 2] > 0.05]
    place = np.floor(pixels[:, :2] / pixels[:, 2:]).astype(int)
    inside = ((place >= 0) & (place < small)).all(axis=1)
    seen = other[place[inside, 1], place[inside, 0]]
    near = np.abs(seen - pixels[inside, 2]) < 0.05 * pixels[inside, 2]
    return float(near.sum() / max(len(points), 1))


def gathered(scenes: Iterable[Scene]) -> Statistics:
    found = Statistics()
    for scene in scenes:
        for reference, *sources in evenly_spaced(view_tuples(scene, 3, (0.1, 5.0))[0], TUPLES):
            found.add_frame(scene.frame(reference))
            for source in sources:
                found.add_pair(scene.frame(reference), scene.frame(source))
    return found


def real(folder: Path) -> Iterator[tuple[str, Statistics]]:
    for path in sorted(folder.iterdir()):
        if (path / "labels").is_dir() and not (path / "poses").is_dir():
            found = Statistics()
            for scene in SingleViews(path)[::8]:
                found.add_frame(scene.frame(0))
            yield path.name, found
        elif (path / "views.txt").exists() or list(path.glob("*/views.txt")):
            yield path.name, gathered(open_data(str(path)))


def report(columns: dict[str, dict]) -> None:
    table = Table("", *columns, title="percentiles 10 / 50 / 90; classes in % of the pixels")
    for name in QUANTITIES:
        cells = (column[name] for column in columns.values())
        table.add_row(
            name, *("-" if c is None else " / ".join(f"{value:.2f}" for value in c) for c in cells)
        )
    for name in SCANNET20.names:
        shares = (100 * column["classes"][name] for column in columns.values())
        table.add_row(name, *(f"{share:.1f}" if share else "-" for share in shares))
    Console(width=200).print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, nargs="?", help="folder of real sequences")
    parser.add_argument("--rooms", type=int, default=40, help="rooms of rooms:train")
    parser.add_argument("--assets", help="folder of an asset pack for the rooms")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    rooms = open_data(f"rooms:train:0-{arguments.rooms}", room_frames=3, assets=arguments.assets)
    columns = {"rooms": gathered(rooms).as_json()}
    if arguments.data:
        columns |= {name: found.as_json() for name, found in real(arguments.data)}
    report(columns)
    if arguments.out:
        record = {"rooms": arguments.rooms, **provenance(), "statistics": columns}
        arguments.out.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
