"""Any scene written as a posed folder, or in nerfstudio's form."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image

from mvsam.data.about import About
from mvsam.data.files import load_matrix
from mvsam.data.labels import SCANNET20
from mvsam.data.readers.posed_folder import read_classes
from mvsam.errors import InputError
from mvsam.files import write_json, write_matrix, write_whole
from mvsam.geometry.camera import HALF_PIXEL
from mvsam.geometry.depth_map import to_millimetres
from mvsam.geometry.pose import OPENCV_FROM_OPENGL
from mvsam.types import Frame, Scene

PhotoFormat = Literal["JPEG", "PNG"]
_JPEG = {"quality": 95, "subsampling": 0}


def write_posed_folder(scene: Scene, folder: Path, photos: PhotoFormat = "JPEG") -> Iterator[str]:
    """Writes frame by frame, yielding each name when its files are whole.

    What is there already is kept, so a stopped run goes on; InputError where that is another scene,
    the same one at another scale, or in another form. Calibrations are written with integer pixel
    centres, as OpenCV counts them: one `intrinsics.txt` where all photos share it.
    """
    frames = _posed_frames(scene)
    matrices = _calibrations(frames)
    _check_form(folder, ("transforms.json", "images", "pose"))
    _check_names(frames, folder, ("color", "depth", "labels", "poses"))
    _check_same_cameras(frames, matrices, folder)
    _check_same_classes(scene, folder)
    _write_classes(scene, folder)
    for file, matrix in matrices.items():
        write_matrix(folder / file, matrix)
    for frame in frames:
        pose = folder / "poses" / f"{frame.name}.txt"  # written last, so it says that all is there
        if not pose.exists():
            _write_pixels(frame, folder, "color", photos)
            write_matrix(pose, frame.world_from_cam)
        yield frame.name
    if (tuples := scene.views()) is not None:
        lines = ["# reference, then sources, best first"]
        lines += [" ".join(frames[index].name for index in views) for views in tuples]
        text = "\n".join([*lines, ""]).encode()
        write_whole(folder / "views.txt", lambda file: file.write(text))


def write_nerfstudio(scene: Scene, folder: Path, photos: PhotoFormat = "JPEG") -> Iterator[str]:
    """The same as `transforms.json` with `images/`, `depth/` and `labels/`, all written anew.

    InputError for pixels that are no rectangles, which the format cannot say.
    """
    frames, entries = _posed_frames(scene), []
    _check_no_skew(scene.name, frames)
    _check_form(folder, ("color", "poses"))
    _check_names(frames, folder, ("images", "depth", "labels"))
    (folder / "transforms.json").unlink(missing_ok=True)  # of pictures that are now replaced
    _write_classes(scene, folder)
    for frame in frames:
        files = _write_pixels(frame, folder, "images", photos)
        k, (width, height) = frame.intrinsics, frame.size
        entries.append(
            files
            | {"w": width, "h": height, "fl_x": k[0, 0], "fl_y": k[1, 1]}
            | {"cx": k[0, 2], "cy": k[1, 2]}
            | {"transform_matrix": (frame.world_from_cam @ OPENCV_FROM_OPENGL).tolist()}
        )
        yield frame.name
    content: dict[str, Any] = {"camera_model": "PINHOLE", "depth_unit_scale_factor": 1e-3}
    write_json(folder / "transforms.json", content | {"frames": entries})


def _check_no_skew(scene: str, frames: Sequence[Frame]) -> None:
    for frame in frames:
        if abs(skew := frame.intrinsics[0, 1]) > 1e-6:
            raise InputError(
                f"{scene} frame {frame.name}: has a skew of {skew:.3g} pixels, which "
                "transforms.json cannot hold; write a posed folder."
            )


def _posed_frames(scene: Scene) -> list[Frame]:
    if not About.of(scene).has_poses:
        raise InputError(
            f"{scene.name}: is a photo without pose, and both forms need one for each photo; "
            "--poses colmap finds those of photos of one room."
        )
    return [scene.frame(index) for index in range(len(scene))]


def _calibrations(frames: Sequence[Frame]) -> dict[Path, np.ndarray]:
    """File in the posed folder -> 3x3 matrix, integer pixel centres."""
    first = frames[0]
    if all(f.size == first.size and (f.intrinsics == first.intrinsics).all() for f in frames):
        return {Path("intrinsics.txt"): first.intrinsics - HALF_PIXEL}
    return {Path("intrinsics", f"{f.name}.txt"): f.intrinsics - HALF_PIXEL for f in frames}


def _check_form(folder: Path, others: Sequence[str]) -> None:
    """InputError where a file or folder is there that the form to be written does not have."""
    for name in others:
        if (folder / name).exists():
            raise InputError(
                f"{folder / name}: belongs to a scene in another form; give another folder as "
                "--out."
            )


def _check_names(frames: Sequence[Frame], folder: Path, places: Sequence[str]) -> None:
    names = {frame.name for frame in frames}
    files = (file for place in places for file in sorted(folder.glob(f"{place}/[!.]*")))
    if (stranger := next((file for file in files if file.stem not in names), None)) is not None:
        raise InputError(
            f"{stranger}: belongs to another scene; give another folder as --out, or remove that "
            "one."
        )


def _check_same_cameras(
    frames: Sequence[Frame], matrices: dict[Path, np.ndarray], folder: Path
) -> None:
    for frame in frames:
        file = folder / "poses" / f"{frame.name}.txt"
        if not file.exists():
            continue
        if not np.allclose(load_matrix(file, 4, 4, "pose"), frame.world_from_cam, atol=1e-6):
            raise InputError(
                f"{file}: is there with another pose, of another scene or --scale; give another "
                "folder as --out, or remove that one."
            )
    for file in [*folder.glob("intrinsics.txt"), *sorted(folder.glob("intrinsics/[!.]*"))]:
        matrix = matrices.get(file.relative_to(folder))
        if matrix is None or not np.allclose(
            load_matrix(file, 3, 3, "intrinsics matrix"), matrix, rtol=1e-6
        ):
            raise InputError(
                f"{file}: is there with other intrinsics, of another scene; give another folder as "
                "--out, or remove that one."
            )


def _check_same_classes(scene: Scene, folder: Path) -> None:
    has_labels = next(folder.glob("labels/[!.]*"), None) is not None
    if has_labels and read_classes(folder) != About.of(scene).classes:
        raise InputError(
            f"{folder / 'labels'}: holds labels of other classes than those of {scene.name}; give "
            "another folder as --out, or remove that one."
        )


def _write_pixels(frame: Frame, folder: Path, place: str, photos: PhotoFormat) -> dict[str, str]:
    """Photo, depth and labels; the keys are nerfstudio's, the paths relative to the folder."""
    ending, options = ("jpg", _JPEG) if photos == "JPEG" else ("png", {})
    files = {"file_path": f"{place}/{frame.name}.{ending}"}
    _save(folder / files["file_path"], Image.fromarray(frame.image), photos, **options)
    if (depth := frame.depth) is not None:
        files["depth_file_path"] = f"depth/{frame.name}.png"
        _save(folder / files["depth_file_path"], Image.fromarray(to_millimetres(depth)), "PNG")
    if (labels := frame.labels) is not None:
        files["label_file_path"] = f"labels/{frame.name}.png"
        _save(folder / files["label_file_path"], Image.fromarray(labels), "PNG")
    return files


def _write_classes(scene: Scene, folder: Path) -> None:
    """`classes.json`, or none for ScanNet's 20."""
    classes, path = About.of(scene).classes, folder / "classes.json"
    if classes == SCANNET20:
        path.unlink(missing_ok=True)
        return
    pairs = zip(classes.names, classes.colors, strict=True)
    content = [{"name": name, "color": list(color)} for name, color in pairs]
    text = json.dumps(content, indent=1).encode()
    write_whole(path, lambda file: file.write(text))


def _save(path: Path, picture: Image.Image, format: str, **options: Any) -> None:
    write_whole(path, lambda file: picture.save(file, format=format, **options))
