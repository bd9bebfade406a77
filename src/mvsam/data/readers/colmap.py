"""COLMAP models, text and binary, every perspective camera model, read through pycolmap.

A model's unit is arbitrary unless it was aligned: give `--scale`, metres a unit.
"""

import logging
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mvsam.data.files import check_photo, load_photo
from mvsam.data.readers.listed import ListedScene, checked, corner_intrinsics, file_inside
from mvsam.data.undistort import undistort
from mvsam.errors import InputError, MissingExtraError
from mvsam.types import Frame

_MODEL_PLACES = ("sparse/0", "sparse", "colmap/sparse/0", "")
_PHOTO_PLACES = ("images", "color", "rgb", "")

log = logging.getLogger("mvsam")


@dataclass(frozen=True)
class ColmapLens:
    """What a COLMAP camera does to rays, beyond its pinhole matrix."""

    model: str
    size: tuple[int, int]
    params: tuple[float, ...]
    intrinsics: Float[np.ndarray, "3 3"]

    def bend(self, rays: Float[np.ndarray, "*shape 2"]) -> Float[np.ndarray, "*shape 2"]:
        """Where the lens puts a straight ray, both at z = 1."""
        camera = _import_pycolmap().Camera(
            model=self.model, width=self.size[0], height=self.size[1], params=list(self.params)
        )
        flat = rays.reshape(-1, 2)
        pixels = camera.img_from_cam(np.column_stack([flat, np.ones(len(flat))]))
        focal, centre = np.diag(self.intrinsics)[:2], self.intrinsics[:2, 2]
        return ((pixels - centre) / focal).reshape(rays.shape)


def is_colmap(path: Path) -> bool:
    return _model_folder(path) is not None


def open_colmap(path: Path) -> ListedScene:
    """The scene of a folder with a model (`sparse/0`, or the folder itself) and its photos.

    Photos are sought in `images/`, `color/`, `rgb/`, the folder itself, and above a bare model.
    """
    folder = _model_folder(path)
    if folder is None:
        raise InputError(f"{path}: no COLMAP model (cameras, images) in it or in sparse/0.")
    pycolmap = _import_pycolmap()
    try:
        model = pycolmap.Reconstruction(str(folder))
    except Exception as error:  # pycolmap raises many kinds for damaged files
        raise InputError(f"{folder}: COLMAP cannot read this model ({error}).") from error
    images = sorted(
        (image for image in model.images.values() if image.has_pose), key=lambda image: image.name
    )
    photos = _photo_folder(path, folder, [image.name for image in images])
    frames = [_frame(photos, image, model.cameras[image.camera_id], folder) for image in images]
    log.warning(
        "%s: a COLMAP model has no unit; depths are metric only if it was aligned, or with "
        "--scale, metres a unit.",
        path,
    )
    return ListedScene(path.resolve().name, frames)


def _frame(photos: Path, image, camera, folder: Path) -> Frame:
    item = f"{folder}: {image.name}"
    file = file_inside(photos, image.name, item)
    size = check_photo(file)
    intrinsics = corner_intrinsics(
        camera.focal_length_x,
        camera.focal_length_y,
        camera.principal_point_x,
        camera.principal_point_y,
        has_integer_centres=False,
    )
    if size != (camera.width, camera.height):
        raise InputError(
            f"{item}: is {size[0]}x{size[1]}, but its camera {camera.width}x{camera.height}; "
            "use the photos the model was made from."
        )
    cam_from_world = np.eye(4)
    cam_from_world[:3] = image.cam_from_world().matrix()
    if _is_pinhole(camera):
        load = partial(load_photo, file)
    else:
        params = tuple(float(value) for value in camera.params)
        lens = ColmapLens(camera.model_name, size, params, intrinsics)
        load = partial(_load_straight, file, intrinsics, lens)
    frame = Frame(
        name=image.name.rsplit(".", 1)[0].replace("/", "_"),
        size=size,
        intrinsics=intrinsics,
        world_from_cam=np.linalg.inv(cam_from_world),
        load_image=load,
    )
    return checked(frame, item)


def _load_straight(file: Path, intrinsics: np.ndarray, lens: ColmapLens) -> np.ndarray:
    return undistort(load_photo(file), intrinsics, lens)


def _is_pinhole(camera) -> bool:
    if camera.model_name == "EQUIRECTANGULAR":
        raise InputError("COLMAP's EQUIRECTANGULAR pictures cannot be made pinhole; cut them up.")
    return camera.model_name in ("PINHOLE", "SIMPLE_PINHOLE")


def _model_folder(path: Path) -> Path | None:
    for place in _MODEL_PLACES:
        folder = path / place
        if any(
            all((folder / f"{name}.{ending}").is_file() for name in ("cameras", "images"))
            for ending in ("bin", "txt")
        ):
            return folder
    return None


def _photo_folder(path: Path, model: Path, names: list[str]) -> Path:
    if not names:
        raise InputError(f"{model}: the model has no image with a pose.")
    places = [path / place for place in _PHOTO_PLACES]
    if model == path:  # a bare model: its photos may lie beside sparse/0
        places += [above / "images" for above in path.resolve().parents[:2]]
    for place in places:
        if (place / names[0]).is_file():
            return place
    raise InputError(f"{path}: its photo {names[0]} is not in images/; put the photos there.")


def _import_pycolmap():
    try:
        import pycolmap
    except ImportError as error:
        raise MissingExtraError("COLMAP models", "pycolmap", "colmap") from error
    return pycolmap
