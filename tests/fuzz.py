"""Coverage-guided fuzzing of readers of binary and small text files; needs Linux, `mvsam[fuzz]`.

    python -m tests.fuzz sens split --seconds 300           made-up files until the time is over
    python -m tests.fuzz sens --again found/sens/crash-1f2e  what was found, once more

Without a name every target takes its turn. A find is an input that ends in another error than ours,
takes more than ten seconds, or more memory than a file of its size can need; it ends its target.
atheris sees the branches of Python code alone: what pycolmap, Pillow, safetensors and torch do
inside is tried blindly, from valid files.
"""

import argparse
import hashlib
import importlib
import logging
import multiprocessing
import re
import resource
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import atheris  # pyright: ignore
import numpy as np
import PIL.Image
import pycolmap
import safetensors.torch
import torch

from mvsam.encoders import feature_cache
from mvsam.errors import InputError
from mvsam.types import Frame, Scene
from mvsam.weights import tensors

# Counts branches in what is imported here for the first time, or again.
with atheris.instrument_imports(include=["mvsam", "PIL", "zipfile"]):  # pyright: ignore
    PIL.Image.preinit()
    for module in (zipfile, feature_cache, tensors):
        importlib.reload(module)
    from mvsam.data.cache import cached_scene
    from mvsam.data.formats import FORMATS
    from mvsam.data.splits import read_tuples

from tests.data.readers.layouts import LAYOUTS, Listed, write_views_and_classes
from tests.synthetic import synthetic_views

logging.disable()

SECONDS_AN_INPUT = 10
MOST_MEMORY = 256 * 2**20
"""Bytes that one input may add to the process's peak."""
MOST_ADDRESSES = 12 * 2**30
"""Bytes of address space: what asks for more is refused, so that no find stops the machine."""


@dataclass(frozen=True)
class Target:
    """One kind of file. Of a folder of valid files, `file` is the one to be made up."""

    file: str
    prepare: Callable[[Path], object]
    """Writes valid files into an empty folder."""
    read: Callable[[Path], object]
    """Reads all of the folder."""
    mend: Callable[[bytes], bytes] = bytes
    """Makes checksums right, which no made-up file would have."""


def small_frames() -> list[Frame]:
    return [
        Frame(
            view.name, (32, 24), view.intrinsics, view.world_from_cam,
            lambda view=view: view.image, lambda view=view: view.depth,
            lambda view=view: view.labels,
        )
        for view in synthetic_views(2, size=(32, 24))
    ]  # fmt: skip


def scene_file(format: str, file: str, mend: Callable[[bytes], bytes] = bytes) -> Target:
    def prepare(folder: Path) -> None:
        LAYOUTS[format].write(small_frames(), folder)
        if format == "posed-folder":
            write_views_and_classes(folder)

    return Target(file, prepare, lambda folder: read_scene(FORMATS[format].open(folder)), mend)


def arkit_file(name: str) -> Target:
    """Of a scene in a folder in the folder, because the scene's name is that of its files."""
    return Target(
        f"42/42_frames/{name}",
        lambda folder: LAYOUTS["arkitscenes"].write(small_frames(), folder / "42"),
        lambda folder: read_scene(FORMATS["arkitscenes"].open(folder / "42")),
    )


def read_scene(scene: Scene) -> None:
    for index in range(len(scene)):
        frame = scene.frame(index)
        assert frame.image.dtype == np.uint8
        _ = frame.depth, frame.labels


def colmap_file(name: str) -> Target:
    def prepare(folder: Path) -> None:
        LAYOUTS["colmap"].write(small_frames(), folder)
        model = pycolmap.Reconstruction(str(folder / "sparse/0"))
        model.images[1].points2D = pycolmap.Point2DList([pycolmap.Point2D(np.array([3.5, 4.5]))])
        track = pycolmap.Track([pycolmap.TrackElement(1, 0)])
        model.add_point3D(np.array([0.1, 0.2, 2.0]), track)
        model.write_binary(str(folder / "sparse/0"))
        for text in (folder / "sparse/0").glob("*.txt"):
            text.unlink()

    return Target(
        f"sparse/0/{name}.bin", prepare, lambda folder: read_scene(FORMATS["colmap"].open(folder))
    )


def write_split(folder: Path) -> None:
    entry = {"scene": "scene0000_00", "target": 20, "refs": np.array([0, 40])}
    np.save(folder / "split.npy", np.array([entry, entry], dtype=object))  # pyright: ignore


def rooms_cache(folder: Path) -> Scene:
    return cached_scene(Listed(small_frames()), folder)


def features(folder: Path) -> torch.Tensor:
    cache = feature_cache.FeatureCache(folder, lambda: "weights")
    return cache(torch.zeros(1, 3, 4, 4), lambda images: images[:, :, ::2, ::2])


def features_file() -> str:
    with tempfile.TemporaryDirectory() as folder:
        features(Path(folder))
        (file,) = Path(folder).rglob("*.npz")
        return str(file.relative_to(folder))


def small_weights() -> dict[str, torch.Tensor]:
    return {"weight": torch.ones(3, 2), "bias": torch.zeros(3, dtype=torch.float16)}


def with_right_checksums(png: bytes) -> bytes:
    """The chunks of a PNG with their own CRCs; other files as they are."""
    if png[:8] != b"\x89PNG\r\n\x1a\n":
        return png
    whole, place = bytearray(png), 8
    while place + 12 <= len(whole):
        end = place + 8 + int.from_bytes(whole[place : place + 4], "big")
        if end + 4 > len(whole):
            break
        whole[end : end + 4] = zlib.crc32(whole[place + 4 : end]).to_bytes(4, "big")
        place = end + 4
    return bytes(whole)


TARGETS = {
    "sens": scene_file("scannet-sens", "scan.sens"),
    "label-zip": scene_file("scannet-sens", "scan_2d-label-filt.zip"),
    "photo": scene_file("posed-folder", "color/0000.png", with_right_checksums),
    "depth": scene_file("posed-folder", "depth/0000.png", with_right_checksums),
    "labels": scene_file("posed-folder", "labels/0000.png", with_right_checksums),
    "views": scene_file("posed-folder", "views.txt"),
    "classes": scene_file("posed-folder", "classes.json"),
    "transforms": scene_file("nerfstudio", "transforms.json"),
    "replica-camera": scene_file("replica", "cam_params.json"),
    "tum-photos": scene_file("tum", "rgb.txt"),
    "tum-depths": scene_file("tum", "depth.txt"),
    "tum-poses": scene_file("tum", "groundtruth.txt"),
    "tum-camera": scene_file("tum", "intrinsics.txt"),
    "ios-photos": scene_file("ios-logger", "Frames.txt"),
    "ios-poses": scene_file("ios-logger", "ARposes.txt"),
    "pincam": arkit_file("lowres_wide_intrinsics/42_4300.000.pincam"),
    "traj": arkit_file("lowres_wide.traj"),
    "colmap-cameras": colmap_file("cameras"),
    "colmap-images": colmap_file("images"),
    "colmap-points": colmap_file("points3D"),
    "colmap-rigs": colmap_file("rigs"),
    "colmap-frames": colmap_file("frames"),
    "split": Target("split.npy", write_split, lambda folder: read_tuples(folder / "split.npy")),
    "rooms-cache": Target("listed.npz", rooms_cache, lambda f: read_scene(rooms_cache(f))),
    "feature-cache": Target(features_file(), features, features),
    "safetensors": Target(
        "model.safetensors",
        lambda folder: safetensors.torch.save_file(small_weights(), folder / "model.safetensors"),
        lambda folder: tensors.read_tensors(folder / "model.safetensors"),
    ),
    "checkpoint": Target(
        "model.pth",
        lambda folder: torch.save(small_weights(), folder / "model.pth"),
        lambda folder: tensors.read_tensors(folder / "model.pth"),
    ),
}


def peak_memory() -> int:
    """Bytes."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def is_for_want_of_memory(error: BaseException | None) -> bool:
    """Whether an allocation failed below the error: on a larger machine it would have succeeded."""
    if error is None:
        return False
    is_own = isinstance(error, MemoryError) or re.search("bad_alloc|allocate", str(error))
    return bool(is_own) or is_for_want_of_memory(error.__cause__)


def read_or_refuse(target: Target, folder: Path, content: bytes) -> None:
    """Reads made-up content in the place of `target.file`; raises where that is a find."""
    (folder / target.file).write_bytes(target.mend(content))
    before = peak_memory()
    try:
        target.read(folder)
    except InputError as error:
        if is_for_want_of_memory(error):
            raise MemoryError(f"it was refused only when memory had run out: {error}") from error
    if (grown := peak_memory() - before) > MOST_MEMORY:
        raise MemoryError(f"{grown // 2**20} MB for {len(content)} bytes")


def fuzz(name: str, folder: Path, seconds: int, again: Path | None) -> None:
    """Ends the process: with 0 when the time is over, else with what was found."""
    target = TARGETS[name]
    target.prepare(folder)
    seed = (folder / target.file).read_bytes()
    target.read(folder)  # is valid, and imports what is imported late
    corpus = folder / "corpus"
    corpus.mkdir()
    (corpus / "seed").write_bytes(seed)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_ADDRESSES, MOST_ADDRESSES))
    options = [
        f"-max_total_time={seconds}", f"-timeout={SECONDS_AN_INPUT}", "-rss_limit_mb=3072",
        f"-max_len={2 * len(seed)}", f"-artifact_prefix={folder}/", "-print_final_stats=1",
        "-len_control=0",
    ]  # fmt: skip
    atheris.Setup([name, *options, str(again or corpus)], partial(read_or_refuse, target, folder))
    atheris.Fuzz()


def in_a_process(name: str, found: Path, seconds: int, again: Path | None) -> bool:
    """Whether nothing was found; libFuzzer ends its process, and a crash would end ours."""
    found.mkdir(parents=True, exist_ok=True)
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        process = multiprocessing.get_context("fork").Process(
            target=fuzz, args=(name, Path(folder), seconds, again)
        )
        process.start()
        process.join()
        if process.exitcode:  # the file it was reading
            content = (Path(folder) / TARGETS[name].file).read_bytes()
            digest = hashlib.sha256(content).hexdigest()
            (found / f"crash-{digest[:8]}").write_bytes(content)
    print(f"{name}: {'a find' if process.exitcode else 'nothing found'}", flush=True)
    return process.exitcode == 0


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("targets", nargs="*", help=f"of {', '.join(TARGETS)}; none: all")
    parser.add_argument("--seconds", type=int, default=300, help="for each target")
    parser.add_argument("--found", type=Path, default=Path("out/fuzz"), help="folder for finds")
    parser.add_argument("--again", type=Path, help="read this file instead of making files up")
    arguments = parser.parse_args()
    names = arguments.targets or list(TARGETS)
    if unknown := set(names) - set(TARGETS):
        parser.error(f"no target {', '.join(unknown)}; there are {', '.join(TARGETS)}")
    clean = [
        in_a_process(name, arguments.found / name, arguments.seconds, arguments.again)
        for name in names
    ]
    sys.exit(not all(clean))


if __name__ == "__main__":
    main()
