"""ScanNet's `.sens` files as folders of pictures, frame by frame and in several processes.

The layout is that of ScanNet's own exporter, which our reader `scannet` opens: color/, depth/,
pose/, intrinsic/, and label-filt/ (or label/, where that is what we have) from the scan's zip.
"""

import io
from collections.abc import Container, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from PIL import Image

from mvsam.data.nyu40 import TSV, find_tsv
from mvsam.data.readers.label_zip import find_label_zip, list_labels, read_label
from mvsam.data.readers.scannet import is_sens, open_scannet_folder
from mvsam.data.readers.sens import SensFile
from mvsam.data.splits import is_scene_list, listed_scenes
from mvsam.data.view_rules import prescribe, read_rule
from mvsam.errors import InputError
from mvsam.files import write_matrix, write_whole
from mvsam.geometry.camera import HALF_PIXEL

CHUNK = 16
"""Frames that a process writes before it reports."""
DEPTH_RANGE = (0.1, 5.0)
"""Metres over which keyframes must overlap."""


@dataclass(frozen=True)
class Job:
    """Some frames of one scan to be written into a folder."""

    sens: Path
    labels: Path | None
    """The scan's label zip."""
    out: Path
    frames: tuple[int, ...]
    size: tuple[int, int] | None
    """(width, height) of the written photos; None: as they are, byte for byte."""

    def label_file(self, index: int) -> Path:
        is_filtered = self.labels is not None and self.labels.name.endswith("-filt.zip")
        return self.out / ("label-filt" if is_filtered else "label") / f"{index}.png"


def find_scans(path: Path) -> list[Path]:
    """The folders with a `.sens` that a path names: one, those in it, or those of a list."""
    if is_scene_list(path.name):
        return listed_scenes(path)
    if not path.is_dir():
        raise InputError(f"{path}: there is no such folder; give that of a scan, or of several.")
    folders = [path, *sorted(p for p in path.iterdir() if p.is_dir())]
    if not (found := [folder for folder in folders if is_sens(folder)]):
        raise InputError(f"{path}: there is no .sens in it or in its folders; download scans.")
    return found


def named_scans(scans: Sequence[Path], rule: str) -> list[Path]:
    """Those that `view_rules.prescribe` gives tuples to.

    InputError for an unknown rule, and for a file that names none of them.
    """
    if (by_scene := read_rule(rule)) is None:
        return list(scans)
    if not (named := [scan for scan in scans if scan.resolve().name in by_scene]):
        raise InputError(
            f"{rule}: names none of these scans ({scans[0].resolve().name}, ...) but "
            f"{next(iter(by_scene))}, ...; is it for other data?"
        )
    return named


def plan(
    scan: Path, out: Path, every: int = 1, size: tuple[int, int] | None = None
) -> tuple[list[Job], int]:
    """(what is left of a scan's folder to be written into `out`, number of frames done before).

    A frame is done if its pose is there, which is written after photo and depth, and its label if
    the zip has one, which may have been downloaded later. Frames without tracking have no picture,
    only their pose of -inf, as in ScanNet's own export.
    """
    files = sorted(scan.glob("*.sens"))
    if len(files) != 1:
        raise InputError(f"{scan}: holds {len(files)} .sens files, expected one; see docs/data.md.")
    source, archive = SensFile(files[0]), find_label_zip(scan)
    labels = list_labels(archive) if archive else {}
    _write_intrinsics(source, out, size)
    wanted = range(0, len(source.frames), every)
    whole = Job(files[0], archive, out, tuple(wanted), size)
    left = [
        index
        for index in wanted
        if not _pose_file(index, whole).exists() or _lacks_label(source, labels, index, whole)
    ]
    parts = [tuple(left[i : i + CHUNK]) for i in range(0, len(left), CHUNK)]
    return [replace(whole, frames=part) for part in parts], len(wanted) - len(left)


def _lacks_label(scan: SensFile, labels: Container[int], index: int, job: Job) -> bool:
    """Whether the zip has a label of the frame that is not in the folder yet."""
    is_tracked = np.isfinite(scan.frames[index].world_from_cam).all()
    return bool(is_tracked) and index in labels and not job.label_file(index).exists()


def export(jobs: Sequence[Job], workers: int) -> Iterator[int]:
    """Does the jobs in so many processes; yields the number of frames of each when it is done."""
    if workers <= 1:
        for job in jobs:
            yield run(job)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        running = [pool.submit(run, job) for job in jobs]
        try:
            for done in as_completed(running):
                yield done.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def run(job: Job) -> int:
    """Writes the frames of a job and returns their number."""
    scan, labels = _opened(job.sens), _listed(job.labels) if job.labels else {}
    for index in job.frames:
        file, pose = _pose_file(index, job), scan.frames[index].world_from_cam
        if np.isfinite(pose).all() and not file.exists():
            _write_photo(scan, index, job)
            _write_depth(scan, index, job.out)
        if job.labels is not None and _lacks_label(scan, labels, index, job):
            label = read_label(job.labels, labels[index])
            _write_bytes(job.label_file(index), label)
        write_matrix(file, pose)
    return len(job.frames)


def _pose_file(index: int, job: Job) -> Path:
    return job.out / f"pose/{index}.txt"


@lru_cache(maxsize=2)
def _opened(path: Path) -> SensFile:
    return SensFile(path)


_listed = lru_cache(maxsize=2)(list_labels)


def copy_table(scans: Sequence[Path], out: Path) -> None:
    """ScanNet's table of categories goes along where one of the scans has labels."""
    labelled = (scan for scan in scans if find_label_zip(scan))
    if (scan := next(labelled, None)) is not None:
        _write_bytes(out / TSV, find_tsv(scan).read_bytes())


def write_views(folder: Path, rule: str, num_views: int) -> None:
    """`views.txt` of an exported scan by a rule of `view_rules.prescribe`."""
    (scene,) = prescribe([open_scannet_folder(folder)], rule, num_views, DEPTH_RANGE)
    lines = [" ".join(scene.frame(i).name for i in views) for views in scene.views() or ()]
    text = "\n".join([f"# {rule}: reference, then sources", *lines, ""])
    _write_bytes(folder / "views.txt", text.encode())


def _write_photo(scan: SensFile, index: int, job: Job) -> None:
    file = job.out / f"color/{index}.jpg"
    if job.size is None:
        data = scan.color_file(index)
        if data[:2] != b"\xff\xd8":
            file = file.with_suffix(".png")
    else:
        picture = Image.fromarray(scan.color(index)).resize(job.size, Image.Resampling.BILINEAR)
        buffer = io.BytesIO()
        picture.save(buffer, "JPEG", quality=95)
        data = buffer.getvalue()
    _write_bytes(file, data)


def _write_depth(scan: SensFile, index: int, out: Path) -> None:
    """In millimetres, the unit of every scan of ScanNet; weakly packed, which is much faster."""
    pixels = scan.depth_pixels(index)
    if scan.header.depth_units != 1000:
        pixels = np.rint(scan.depth(index) * 1000).clip(0, 65535).astype(np.uint16)
    picture = Image.fromarray(pixels)
    write_whole(
        out / f"depth/{index}.png", lambda stream: picture.save(stream, "PNG", compress_level=1)
    )


def _write_intrinsics(scan: SensFile, out: Path, size: tuple[int, int] | None) -> None:
    """Calibrations for the written sizes, with integer pixel centres.

    Raises `InputError` where the folder holds photos of another size.
    """
    header = scan.header
    width, height = size or header.color_size
    scale = np.array([[width / header.color_size[0]], [height / header.color_size[1]], [1.0]])
    for name, matrix in (
        ("color", header.color_intrinsics * scale),
        ("depth", header.depth_intrinsics),
    ):
        full = np.eye(4)
        full[:3, :3] = matrix - HALF_PIXEL
        file = out / f"intrinsic/intrinsic_{name}.txt"
        if file.exists() and not np.allclose(np.loadtxt(file), full, rtol=1e-6):
            raise InputError(
                f"{out}: was begun with photos of another --size; give that one, or another folder."
            )
        write_matrix(file, full)


def _write_bytes(path: Path, data: bytes) -> None:
    write_whole(path, lambda stream: stream.write(data))
