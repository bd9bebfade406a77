"""Poses for photos that have none: COLMAP's structure from motion, through pycolmap."""

import logging
import tempfile
from pathlib import Path
from typing import Any

from mvsam.data.files import check_photo
from mvsam.data.readers.colmap import import_pycolmap, is_colmap
from mvsam.data.readers.posed_folder import PHOTO_SUFFIXES
from mvsam.data.readers.video import VIDEO_SUFFIXES, thinned_frames
from mvsam.errors import InputError, counted
from mvsam.files import writable_folder

PHOTO_PLACES = ("images", "color", "rgb", "")
"""Folders of a scene in which photos without poses are sought."""
MOST_MATCHED = 150
"""Photos of which every pair is matched; of more, neighbours in the order of names."""
FEWEST_PHOTOS = 3
FEW_PHOTOS = 20
"""Of so few, a bad first pair now and then (one time in twenty of five photos) keeps most from
finding their place: COLMAP draws its samples anew."""
TRIES = 5

log = logging.getLogger("mvsam")


def pose_photos(path: Path) -> Path:
    """The folder with `sparse/0` that COLMAP made of a folder of photos, or of a video.

    A video's frames, two a second, go to a folder of its name beside it. A model that is there
    already is kept; a message names newer photos. Raises `InputError` where COLMAP finds no poses.
    """
    folder = path
    if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file():
        folder = writable_folder(path.with_suffix(""))
        if not is_colmap(folder):
            thinned_frames(path, folder / "images")
    if is_colmap(folder):
        log.info("%s: has a COLMAP model already; that is taken.", folder)
        _warn_of_newer(path, folder)
        return folder
    photos = photo_folder(folder)
    if photos is None:
        raise InputError(f"{path}: neither photos nor a video; give a folder of .jpg or .png.")
    models = writable_folder(folder / "sparse")
    try:
        _reconstruct(photos, models / "0")
    finally:
        if not any(models.iterdir()):
            models.rmdir()
    return folder


def _warn_of_newer(path: Path, folder: Path) -> None:
    """Says so where a video, or photos, changed after the model in `folder/sparse` was made."""
    made = [file.stat().st_mtime for file in (folder / "sparse").rglob("images.*")]
    photos = photo_folder(folder)
    files = _photos(photos) if path == folder and photos else [path]
    times = {file.name: file.stat().st_mtime for file in files if file.is_file()}
    newer = [name for name, time in times.items() if made and time > max(made)]
    if newer:
        log.warning(
            "%s: %s newer than its COLMAP model; to have COLMAP seek poses again, move %s away.",
            folder,
            f"{newer[0]} is" if len(newer) == 1 else f"{len(newer)} photos are",
            folder / "sparse" if path == folder else folder,
        )


def photo_folder(path: Path) -> Path | None:
    """Where photos lie in a scene's folder, or None."""
    return next((path / p for p in PHOTO_PLACES if (path / p).is_dir() and _photos(path / p)), None)


def _photos(folder: Path) -> list[Path]:
    return sorted(f for f in folder.iterdir() if f.suffix.lower() in PHOTO_SUFFIXES)


def _reconstruct(photos: Path, model: Path) -> None:
    """Writes the largest model that COLMAP builds; camera and lens are estimated with it."""
    files = _photos(photos)
    if len(files) < FEWEST_PHOTOS:
        raise InputError(
            f"{photos}: {counted(len(files), 'photo')}, too few for COLMAP; take 3 or more."
        )
    pycolmap = import_pycolmap()
    log.info("%s: COLMAP seeks the poses of %d photos.", photos, len(files))
    with tempfile.TemporaryDirectory(dir=model.parent) as work:
        num_posed, best = 0, Path()
        for seed in range(TRIES if len(files) <= FEW_PHOTOS else 1):
            found = _largest_model(pycolmap, photos, files, Path(work) / str(seed), seed)
            num_posed, best = max((num_posed, best), found)
            if num_posed == len(files):
                break
        if not num_posed:
            raise InputError(
                f"{photos}: COLMAP finds no poses: the photos overlap too little or show too "
                "little texture; take more, walking sideways."
            )
        best.rename(model)
    if num_posed < len(files):
        lost = len(files) - num_posed
        log.warning("%s: COLMAP finds no pose for %d of %d photos.", photos, lost, len(files))


def _largest_model(
    pycolmap: Any, photos: Path, files: list[Path], work: Path, seed: int
) -> tuple[int, Path]:
    """How many photos the largest model has, and where in the new folder `work` it lies; 0: none.

    What is random differs with `seed`.
    """
    work.mkdir()
    try:
        models = _map(pycolmap, photos, files, work, seed)
    except Exception as error:  # pycolmap raises many kinds
        raise InputError(f"{photos}: COLMAP fails ({error}); are these photos?") from error
    sizes = [(model.num_reg_images(), work / str(number)) for number, model in models.items()]
    return max(sizes, default=(0, work))


def _map(pycolmap: Any, photos: Path, files: list[Path], work: Path, seed: int) -> dict:
    """Number of each model, which lies in `work/NUMBER` -> the model."""
    pycolmap.logging.minloglevel = 3  # its errors are told below
    pycolmap.set_random_seed(seed)
    database = work / "database.db"
    one_camera = len({check_photo(file) for file in files}) == 1
    mode = pycolmap.CameraMode.SINGLE if one_camera else pycolmap.CameraMode.AUTO
    names = [file.name for file in files]
    pycolmap.extract_features(database, photos, image_names=names, camera_mode=mode)
    if len(files) <= MOST_MATCHED:
        pycolmap.match_exhaustive(database)
    else:
        pycolmap.match_sequential(database)
    return pycolmap.incremental_mapping(database, photos, work)
