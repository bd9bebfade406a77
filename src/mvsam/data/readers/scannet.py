"""ScanNet scans: raw (`SCENE.sens`, label zip), exported folders, and the 25k frames.

Raw label ids (16 bits) become the 20 classes through scannetv2-labels.combined.tsv; 8-bit label
pictures hold NYU40 ids already.
"""

import io
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from mvsam.data.files import (
    DEPTH_MODES,
    check_photo,
    load_depth,
    load_matrix,
    load_photo,
    load_pixels,
    read_header,
)
from mvsam.data.nyu40 import find_tsv, from_nyu40, from_raw
from mvsam.data.readers.label_zip import find_label_zip, list_labels, read_label
from mvsam.data.readers.listed import ListedScene, checked, numbered_files
from mvsam.data.readers.posed_folder import read_view_tuples
from mvsam.data.readers.register import read_at_pixels
from mvsam.data.readers.sens import SensFile
from mvsam.data.transforms import resize_nearest
from mvsam.errors import InputError
from mvsam.geometry.camera import HALF_PIXEL
from mvsam.types import Frame


def is_sens(path: Path) -> bool:
    return next(path.glob("*.sens"), None) is not None


def open_sens(path: Path) -> ListedScene:
    """The scan of a folder with one `.sens`, with its label zip if that is there.

    It has the folder's name, as its export has, because the file's may be that of other scans too.
    Frames whose tracking was lost are left out, with a message.
    """
    files = sorted(path.glob("*.sens"))
    if len(files) > 1:
        raise InputError(f"{path}: holds {len(files)} .sens files; keep one scan a folder.")
    scan = SensFile(files[0])
    tracked = [i for i, f in enumerate(scan.frames) if np.isfinite(f.world_from_cam).all()]
    labels = _zipped_labels(path, scan.header.color_size)
    frames = [
        checked(scan.frame(i, load_labels=labels.get(i)), f"{files[0]} frame {i}") for i in tracked
    ]
    return ListedScene(path.resolve().name, frames, num_lost=len(scan.frames) - len(frames))


def is_scannet_folder(path: Path) -> bool:
    return (path / "color").is_dir() and (path / "pose").is_dir()


def open_scannet_folder(path: Path) -> ListedScene:
    """An exported scan: color/, pose/, depth/, and label-filt/ or label/, files by frame number.

    A `views.txt`, as in a posed folder, says which frames are seen together.
    """
    photos = sorted(numbered_files(path / "color", (".jpg", ".png")).items())
    files = numbered_files(path / "pose", (".txt",))
    poses = {number: load_matrix(file, 4, 4, "pose") for number, file in files.items()}
    lost = {number for number, pose in poses.items() if not np.isfinite(pose).all()}
    depths = numbered_files(path / "depth", (".png",))
    label_folder = path / "label-filt" if (path / "label-filt").is_dir() else path / "label"
    labels = numbered_files(label_folder, (".png",))
    _check_table(path, labels)
    color, depth = _matrix(path, "color"), _matrix(path, "depth") if depths else None
    frames = []
    for number, photo in photos:
        if number not in poses:
            raise InputError(f"{photo}: has no pose/{photo.stem}.txt; export the scan again.")
        if number in lost:
            continue
        size = check_photo(photo)
        depth_file, label_file = depths.get(number), labels.get(number)
        frame = Frame(
            name=photo.stem,
            size=size,
            intrinsics=color.copy(),
            world_from_cam=poses[number],
            load_image=partial(load_photo, photo),
            load_depth=(
                partial(_load_depth, depth_file, depth, color, size)
                if depth_file and depth is not None
                else None
            ),
            load_labels=partial(_load_labels, label_file, path, size) if label_file else None,
        )
        frames.append(checked(frame, photo))
    file = path / "views.txt"
    views = read_view_tuples(file, [f.name for f in frames]) if file.exists() else None
    return ListedScene(path.resolve().name, frames, views, num_lost=len(lost))


def _check_table(path: Path, labels: dict[int, Path]) -> None:
    """InputError where the labels are raw ids, as the first tells, and their table is missing."""
    if labels and read_header(next(iter(labels.values())), "label map")[1] in DEPTH_MODES:
        find_tsv(path)


def _matrix(path: Path, camera: str) -> Float[np.ndarray, "3 3"]:
    """Of `intrinsic/intrinsic_color.txt` (exports) or `intrinsics_color.txt` (25k frames)."""
    places = path / "intrinsic" / f"intrinsic_{camera}.txt", path / f"intrinsics_{camera}.txt"
    for file in places:
        if file.is_file():
            return load_matrix(file, 4, 4, "intrinsics matrix")[:3, :3] + HALF_PIXEL
    raise InputError(
        f"{path}: neither {places[0].relative_to(path)} nor {places[1].name} is there."
    )


def _load_depth(
    file: Path, depth_intrinsics: np.ndarray, intrinsics: np.ndarray, size: tuple[int, int]
) -> Float[np.ndarray, "height width"]:
    return read_at_pixels(load_depth(file), depth_intrinsics, intrinsics, size)


def _load_labels(
    file: Path, path: Path, size: tuple[int, int]
) -> UInt8[np.ndarray, "height width"]:
    return _to_classes(load_pixels(file, "label map"), path, size, str(file))


def _to_classes(
    ids: np.ndarray, folder: Path, size: tuple[int, int], item: str
) -> UInt8[np.ndarray, "height width"]:
    if ids.ndim != 2:
        raise InputError(f"{item}: the label map has colours; expected one number a pixel.")
    labels = from_nyu40(ids) if ids.dtype == np.uint8 else from_raw(ids, find_tsv(folder))
    return resize_nearest(labels, size)


def _zipped_labels(path: Path, size: tuple[int, int]) -> dict:
    """Loader of each frame's labels from the scan's zip; empty without one."""
    if (archive := find_label_zip(path)) is None:
        return {}
    find_tsv(path)  # now, not in the middle of a run
    return {
        number: partial(_load_zipped, archive, name, size)
        for number, name in list_labels(archive).items()
    }


def _load_zipped(
    archive: Path, name: str, size: tuple[int, int]
) -> UInt8[np.ndarray, "height width"]:
    data, item = read_label(archive, name), f"{archive}: {name}"
    try:
        with Image.open(io.BytesIO(data), formats=("PNG",)) as picture:
            ids = np.array(picture)
    except Exception as error:  # Pillow raises many kinds for damaged data
        raise InputError(f"{item} cannot be read ({error}); download it again.") from error
    return _to_classes(ids, archive.parent, size, item)
