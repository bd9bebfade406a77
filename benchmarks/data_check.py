"""What `mvsam data check` says of right cameras, and of nine ways to break them.

    python benchmarks/data_check.py DATA --out results/data_check.json

DATA holds scene folders, or folders of small scenes. A broken copy is made in memory, so nothing is
written beside the data. Where a break changes the data by less than the check's own tolerance, it
counts as not measurable: the share of surfaces that meet under the right cameras then falls by less
than five hundredths.
"""

import argparse
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from mvsam.data.catalog import scene_folders
from mvsam.data.check.evidence import Evidence
from mvsam.data.formats import find_format, open_scene
from mvsam.data.readers.register import register_depth
from mvsam.data.readers.seven_scenes import COLOR_FROM_DEPTH
from mvsam.geometry.pose import OPENCV_FROM_OPENGL
from mvsam.provenance import provenance
from mvsam.types import Frame

Break = Callable[[list[Frame]], list[Frame]]
DEPTH_RANGE = (0.1, 5.0)
MEASURABLE = 0.05
DEPTH_FOCAL = 585.0 / 520.17
"""Kinect's depth camera against its colour camera."""


def depth_of(frame: Frame) -> np.ndarray:
    depth = frame.depth
    assert depth is not None, "the sequences have depth"
    return depth


def posed(change: Callable[[np.ndarray], np.ndarray]) -> Break:
    return lambda frames: [replace(f, world_from_cam=change(f.world_from_cam)) for f in frames]


def scaled(pose: np.ndarray) -> np.ndarray:
    return np.block([[pose[:3, :3], 1000 * pose[:3, 3:]], [pose[3:]]])


def turned_back(pose: np.ndarray) -> np.ndarray:
    return np.block([[pose[:3, :3].T, pose[:3, 3:]], [pose[3:]]])


def left_handed(pose: np.ndarray) -> np.ndarray:
    negate_y = np.diag([1.0, -1.0, 1.0, 1.0])
    return negate_y @ pose @ negate_y


def half_size(frames: list[Frame]) -> list[Frame]:
    return [replace(f, intrinsics=f.intrinsics * [[0.5], [0.5], [1]]) for f in frames]


def unregistered(frames: list[Frame]) -> list[Frame]:
    """Depth as a Kinect's depth camera sees it: a longer lens, 2 cm beside the colour camera."""

    def seen(frame: Frame) -> np.ndarray:
        depth_camera = frame.intrinsics * [[DEPTH_FOCAL, 1, 1], [1, DEPTH_FOCAL, 1], [1, 1, 1]]
        depth_from_color = np.linalg.inv(COLOR_FROM_DEPTH)
        return register_depth(
            depth_of(frame), frame.intrinsics, depth_camera, depth_from_color, frame.size
        )

    return [replace(f, load_depth=cache(lambda f=f: seen(f))) for f in frames]


def rotated(frames: list[Frame]) -> list[Frame]:
    """Photos and depth turned to portrait, fx and fy (cx and cy) swapped, poses as they were."""
    return [
        replace(
            f,
            size=f.size[::-1],
            intrinsics=f.intrinsics[[1, 0, 2]][:, [1, 0, 2]],
            load_image=cache(lambda f=f: np.rot90(f.load_image(), -1).copy()),
            load_depth=cache(lambda f=f: np.rot90(depth_of(f), -1).copy()),
        )
        for f in frames
    ]


def shuffled(frames: list[Frame]) -> list[Frame]:
    """Every pose goes to another photo, far from its own in the recording."""
    step = max(1, len(frames) // 3)
    poses = [f.world_from_cam for f in frames]
    moved = poses[step:] + poses[:step]
    order = np.random.default_rng(0).permutation(len(frames)) if len(frames) >= 10 else None
    mixed = moved if order is None else [poses[i] for i in order]
    return [replace(f, world_from_cam=pose) for f, pose in zip(frames, mixed, strict=True)]


BREAKS: dict[str, tuple[Break, str]] = {
    "as it is": (lambda frames: frames, ""),
    "inverse": (posed(np.linalg.inv), "world-to-camera; invert"),
    "OpenGL": (posed(lambda pose: pose @ OPENCV_FROM_OPENGL), "in OpenGL axes"),
    "half-size": (half_size, "half the size"),
    "unregistered": (unregistered, "not registered"),
    "transposed": (posed(turned_back), "transposed rotations"),
    "left-handed": (posed(left_handed), "left-handed"),
    "millimetres": (posed(scaled), "millimetres|not metric"),
    "rotated": (rotated, "turned by"),
    "shuffled": (shuffled, "no convention fits"),
}
"""Name -> (how to break, what the check must then say)."""


def check_all(frames: list[Frame]) -> dict[str, dict]:
    right = None
    found = {}
    for kind, (break_it, expected) in BREAKS.items():
        evidence = Evidence.of(break_it(frames), DEPTH_RANGE)
        given = evidence.depth.agreement.get("as given")
        right = given if right is None else right
        is_measurable = right is None or given is None or right - given >= MEASURABLE
        found[kind] = {
            "verdict": judge(evidence.is_suspicious, expected, evidence.advice, is_measurable),
            "agreement": given,
            "photos": evidence.photos,
            "depth": evidence.depth.sentence,
        }
    return found


def judge(is_suspicious: bool, expected: str, said: str, is_measurable: bool) -> str:
    if not expected:
        return "wrong" if is_suspicious else "right"
    if not is_suspicious:
        return "undecided" if is_measurable else "not measurable"
    return "right" if any(words in said for words in expected.split("|")) else "wrong"


def sequences(folder: Path) -> Iterator[Path]:
    for path in sorted(p for p in folder.iterdir() if p.is_dir()):
        yield from [path] if find_format(path) else scene_folders(path)


def frames_in_memory(path: Path) -> list[Frame]:
    scene = open_scene(path)
    frames = [scene.frame(index) for index in range(len(scene))]
    return [
        replace(f, load_image=cache(f.load_image), load_depth=f.load_depth and cache(f.load_depth))
        for f in frames
    ]


def table_of(results: dict[str, dict[str, dict]]) -> Table:
    marks = {"right": "right", "wrong": "WRONG", "undecided": "?", "not measurable": "-"}
    table = Table("sequence", "frames", *BREAKS)
    for name, result in results.items():
        cells = [marks[result["checks"][kind]["verdict"]] for kind in BREAKS]
        table.add_row(name, str(result["frames"]), *cells)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("data", type=Path, help="folder of sequences")
    parser.add_argument("--only", default="", help="sequences whose path contains this")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    record, results = provenance(), {}
    for path in sequences(arguments.data):
        name = str(path.relative_to(arguments.data))
        if arguments.only not in name or not has_poses(path):
            continue
        frames = frames_in_memory(path)
        results[name] = {"frames": len(frames), "checks": check_all(frames)}
        print(name, *(c["verdict"] for c in results[name]["checks"].values()), flush=True)
    Console(width=160).print(table_of(results))
    counts = count(results.values())
    print(counts)
    if arguments.out:
        record |= {"counts": counts, "sequences": results}
        arguments.out.write_text(json.dumps(record, indent=2) + "\n")


def has_poses(path: Path) -> bool:
    return (path / "poses").is_dir()


def count(results: Iterable[dict]) -> dict[str, int]:
    verdicts = [c["verdict"] for result in results for c in result["checks"].values()]
    return {verdict: verdicts.count(verdict) for verdict in sorted(set(verdicts))}


if __name__ == "__main__":
    main()
