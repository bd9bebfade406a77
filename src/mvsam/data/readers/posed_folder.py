"""The posed folder, our own simple format (docs/data.md): photos, poses, intrinsics as files.

Opening a folder reads every small text file and every picture's header, so that bad input is
refused before work begins; pixels are read when a frame is asked for them.
"""

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from mvsam.data.camera_checks import check_intrinsics, check_pose
from mvsam.data.files import (
    Size,
    check_map,
    check_photo,
    load_depth,
    load_labels,
    load_matrix,
    load_photo,
)
from mvsam.data.labels import SCANNET20, ClassTable, read_class_table
from mvsam.data.readers.listed import warn_of_lost
from mvsam.errors import InputError, counted
from mvsam.geometry.camera import HALF_PIXEL
from mvsam.types import Frame

PHOTO_SUFFIXES = (".jpg", ".jpeg", ".png")
Files = dict[str, Path]
"""Stem -> file."""


def is_posed_folder(path: Path) -> bool:
    return (path / "color").is_dir() and (path / "poses").is_dir()


class PosedFolder:
    """A `Scene` of one posed folder.

    Raises `InputError` for a folder that is not whole: see `data.files` and `data.camera_checks`.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self.name = self.path.resolve().name
        self.classes = read_classes(self.path)
        photos = list_photos(self.path)
        poses = _by_stem(self.path / "poses", (".txt",), "pose")
        _check_pairing(self.path, photos, poses)
        self._sizes = {name: check_photo(photo) for name, photo in photos.items()}
        intrinsics = read_intrinsics(self.path, self._sizes)
        self._depth = list_maps(self.path, "depth", self._sizes)
        self._labels = list_maps(self.path, "label", self._sizes)
        matrices = {name: load_matrix(poses[name], 4, 4, "pose") for name in photos}
        tracked = [name for name, matrix in matrices.items() if np.isfinite(matrix).all()]
        self.num_lost = len(photos) - len(tracked)
        warn_of_lost(self.name, len(photos), self.num_lost)
        for name in tracked:
            check_pose(matrices[name], str(poses[name]))
        self._frames = [
            self._make_frame(name, photos[name], matrices[name], intrinsics[name])
            for name in tracked
        ]
        self._views = self._read_views(tracked)

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> Frame:
        return self._frames[index]

    def views(self) -> list[tuple[int, ...]] | None:
        """The tuples of `views.txt` (reference, then sources, best first), or None without it."""
        return self._views

    def _make_frame(
        self, name: str, photo: Path, world_from_cam: np.ndarray, intrinsics: np.ndarray
    ) -> Frame:
        depth, labels = self._depth.get(name), self._labels.get(name)
        return Frame(
            name=name,
            size=self._sizes[name],
            intrinsics=intrinsics,
            world_from_cam=world_from_cam,
            load_image=partial(load_photo, photo),
            load_depth=partial(load_depth, depth) if depth else None,
            load_labels=partial(load_labels, labels, len(self.classes)) if labels else None,
        )

    def _read_views(self, tracked: Sequence[str]) -> list[tuple[int, ...]] | None:
        """Without lost photos, and without tuples of which nothing but one photo is left."""
        file = self.path / "views.txt"
        if not file.exists():
            return None
        names, place = list(self._sizes), {name: index for index, name in enumerate(tracked)}
        tuples = [[names[i] for i in views] for views in read_view_tuples(file, names)]
        kept = [[name for name in views if name in place] for views in tuples if views[0] in place]
        if not any(len(views) > 1 for views in kept):
            raise InputError(f"{file}: none of its tuples has two photos with a pose.")
        return [tuple(place[name] for name in views) for views in kept if len(views) > 1]


def list_photos(path: Path) -> Files:
    """The photos of `color/`; InputError for none."""
    photos = _by_stem(path / "color", PHOTO_SUFFIXES, "photo")
    if not photos:
        raise InputError(f"{path / 'color'}: no photos found; put NAME.jpg or NAME.png there.")
    return photos


def list_maps(path: Path, kind: str, sizes: dict[str, Size]) -> Files:
    """Depth or label PNGs; a photo may lack one, but each must belong to a photo."""
    folder = path / {"depth": "depth", "label": "labels"}[kind]
    maps = _by_stem(folder, (".png",), f"{kind} map") if folder.exists() else {}
    for name, file in maps.items():
        if name not in sizes:
            raise InputError(
                f"{file}: no photo color/{name}.jpg or .png belongs to this {kind} map; "
                "name it like its photo or remove it."
            )
        check_map(file, kind, sizes[name])
    return maps


def read_classes(path: Path) -> ClassTable:
    """Those of `classes.json`, or ScanNet's 20 without it."""
    file = path / "classes.json"
    return read_class_table(file) if file.exists() else SCANNET20


def read_intrinsics(path: Path, sizes: dict[str, Size]) -> dict[str, Float64[np.ndarray, "3 3"]]:
    """For each photo, corner convention; the files count pixel centres at integers, as OpenCV."""
    shared, folder = path / "intrinsics.txt", path / "intrinsics"
    if folder.is_dir():
        files = {name: folder / f"{name}.txt" for name in sizes}
    else:
        _check_one_size(shared, sizes)
        files = dict.fromkeys(sizes, shared)
    matrices = {file: load_matrix(file, 3, 3, "intrinsics matrix") for file in set(files.values())}
    for name, file in files.items():
        check_intrinsics(matrices[file], sizes[name], str(file))
    return {name: matrices[file] + HALF_PIXEL for name, file in files.items()}


def read_view_tuples(file: Path, names: Iterable[str]) -> list[tuple[int, ...]]:
    """Tuples of indices into `names` from lines of names; `#` starts a comment."""
    index_of = {name: index for index, name in enumerate(names)}
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read ({error}); write it as plain text.") from error
    tuples = []
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        item = f"{file} line {number}"
        if unknown := [word for word in words if word not in index_of]:
            raise InputError(
                f"{item}: there is no photo named {unknown[0]}; write file names without ending."
            )
        if len(words) < 2:
            raise InputError(f"{item}: a reference needs at least one source behind it; add one.")
        if len(set(words)) < len(words):
            raise InputError(f"{item}: a photo occurs twice in one tuple; name each once.")
        if any(views[0] == index_of[words[0]] for views in tuples):
            raise InputError(f"{item}: {words[0]} is a reference already; give it one tuple.")
        tuples.append(tuple(index_of[word] for word in words))
    if not tuples:
        raise InputError(f"{file}: holds no view tuple; add one a line or remove the file.")
    return tuples


def _by_stem(folder: Path, suffixes: tuple[str, ...], kind: str) -> Files:
    """The folder's files with these suffixes, sorted by stem; two with one stem are an error."""
    if not folder.is_dir():
        raise InputError(f"{folder}: this folder is missing; it holds one {kind} a frame.")
    files: Files = {}
    for file in sorted(folder.iterdir(), key=lambda file: (file.stem, file.name)):
        if file.suffix.lower() not in suffixes or file.name.startswith("."):
            continue
        if file.stem in files:
            raise InputError(
                f"{folder}: {files[file.stem].name} and {file.name} have the same name before the "
                "ending; rename or remove one."
            )
        files[file.stem] = file
    return files


def _check_pairing(path: Path, photos: Files, poses: Files) -> None:
    """Raise unless photos and poses have the same names."""
    without_pose = sorted(photos.keys() - poses.keys())
    without_photo = sorted(poses.keys() - photos.keys())
    if not without_pose and not without_photo:
        return
    complaints = [f"no pose for {_some(without_pose)}"] if without_pose else []
    complaints += [f"no photo for {_some(without_photo)}"] if without_photo else []
    raise InputError(
        f"{path}: {counted(len(photos), 'photo')} but {counted(len(poses), 'pose')}, "
        f"{' and '.join(complaints)}; "
        "every color/NAME.jpg or .png needs its poses/NAME.txt and nothing else may lie there."
    )


def _some(names: list[str], limit: int = 3) -> str:
    return ", ".join(names[:limit]) + (f" and {len(names) - limit} more" if names[limit:] else "")


def _check_one_size(shared: Path, sizes: dict[str, Size]) -> None:
    """Raise if one intrinsics file has to serve photos of different sizes."""
    first_name, first = next(iter(sizes.items()))
    for name, size in sizes.items():
        if size != first:
            raise InputError(
                f"{shared}: photo {name} is {size[0]}x{size[1]} but {first_name} is "
                f"{first[0]}x{first[1]}; give each its own intrinsics/NAME.txt."
            )
