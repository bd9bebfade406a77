"""COLMAP models, text and binary, every perspective camera model, read through pycolmap.

A model's unit is arbitrary unless it was aligned: give `--scale`, metres a unit or between two
cameras, or put measured depth beside the photos, from which it is found.
"""

import logging
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mvsam.data.camera_checks import check_pose
from mvsam.data.files import check_map, check_photo, is_file, load_depth, load_photo
from mvsam.data.readers.colmap_binary import check_binary_model
from mvsam.data.readers.colmap_scale import metres_a_unit
from mvsam.data.readers.listed import ListedScene, checked, corner_intrinsics, file_inside
from mvsam.data.readers.undistort import undistort
from mvsam.data.scaled import ScaledScene
from mvsam.errors import InputError, MissingExtraError
from mvsam.types import Frame, Scene

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
        camera = import_pycolmap().Camera(
            model=self.model, width=self.size[0], height=self.size[1], params=list(self.params)
        )
        flat = rays.reshape(-1, 2)
        pixels = camera.img_from_cam(np.column_stack([flat, np.ones(len(flat))]))
        focal, centre = np.diag(self.intrinsics)[:2], self.intrinsics[:2, 2]
        return ((pixels - centre) / focal).reshape(rays.shape)


def is_colmap(path: Path) -> bool:
    return _model_folder(path) is not None


def open_colmap(path: Path) -> Scene:
    """The scene of a folder with a model (`sparse/0`, or the folder itself) and its photos.

    Photos are sought in `images/`, `color/`, `rgb/`, the folder itself, and above a bare model;
    measured depth (16-bit PNGs in millimetres, named like the photos) in `depth/` beside them.
    """
    folder = _model_folder(path)
    if folder is None:
        raise InputError(f"{path}: no COLMAP model (cameras, images) in it or in sparse/0.")
    pycolmap = import_pycolmap()
    check_binary_model(folder)
    try:
        model = pycolmap.Reconstruction(str(folder))
        posed = (image for image in model.images.values() if image.has_pose)
        images = sorted(posed, key=lambda image: image.name)
    except Exception as error:  # pycolmap raises many kinds for damaged files, for names too
        raise InputError(f"{folder}: COLMAP cannot read this model ({error}).") from error
    photos = _photo_folder(path, folder, [image.name for image in images])
    depths = _depth_files(photos, [image.name for image in images])
    frames = [
        _frame(photos, image, model.cameras[image.camera_id], folder, depths.get(image.name))
        for image in images
    ]
    points = np.array([point.xyz for point in model.points3D.values()]).reshape(-1, 3)
    num_lost = len(model.images) - len(images)
    scene = ListedScene(
        path.resolve().name, frames, points=points, num_lost=num_lost, has_unit=False
    )
    scale = metres_a_unit(model, images, depths)
    if scale is None:
        return scene
    log.info("%s: one unit of the model is %.4g m by the measured depth.", path, scale)
    return ScaledScene(scene, scale)


def _depth_files(photos: Path, names: list[str]) -> dict[str, Path]:
    """Name of each image that has a measured depth -> its file."""
    folder = (photos.parent if photos.name else photos) / "depth"
    files = {name: file_inside(folder, name, str(photos)).with_suffix(".png") for name in names}
    return {name: file for name, file in files.items() if is_file(file)}


def _frame(photos: Path, image, camera, folder: Path, depth: Path | None) -> Frame:
    item = f"{folder}: {image.name}"
    file = file_inside(photos, image.name, item)
    size = check_photo(file)
    if camera.model_name == "EQUIRECTANGULAR":  # pycolmap crashes when asked for its focal length
        raise InputError(
            f"{item}: COLMAP's EQUIRECTANGULAR pictures cannot be made pinhole; cut them up."
        )
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
    check_pose(cam_from_world, item)  # before it is inverted: a damaged quaternion may be all 0
    lens = None if _is_pinhole(camera) else _lens(camera, size, intrinsics)
    if depth:
        check_map(depth, "depth", size)
    frame = Frame(
        name=image.name.rsplit(".", 1)[0].replace("/", "_"),
        size=size,
        intrinsics=intrinsics,
        world_from_cam=np.linalg.inv(cam_from_world),
        load_image=partial(_load_photo, file, intrinsics, lens),
        load_depth=partial(_load_depth, depth, intrinsics, lens) if depth else None,
    )
    return checked(frame, item)


def _lens(camera, size: tuple[int, int], intrinsics: np.ndarray) -> ColmapLens:
    params = tuple(float(value) for value in camera.params)
    return ColmapLens(camera.model_name, size, params, intrinsics)


def _load_photo(file: Path, intrinsics: np.ndarray, lens: ColmapLens | None) -> np.ndarray:
    photo = load_photo(file)
    return undistort(photo, intrinsics, lens) if lens else photo


def _load_depth(file: Path, intrinsics: np.ndarray, lens: ColmapLens | None) -> np.ndarray:
    depth = load_depth(file)
    return undistort(depth, intrinsics, lens, outside=0) if lens else depth


def _is_pinhole(camera) -> bool:
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
        if is_file(place / names[0]):
            return place
    raise InputError(f"{path}: its photo {names[0]} is not in images/; put the photos there.")


def import_pycolmap(feature: str = "COLMAP models"):
    try:
        import pycolmap
    except ImportError as error:
        raise MissingExtraError(feature, "pycolmap", "colmap") from error
    return pycolmap
