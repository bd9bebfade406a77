"""The output folder of `mvsam predict`: which file holds what, written whole.

One photo's maps, NAME being the photo's: `color/NAME.jpg`, `depth/NAME.png` (16-bit millimetres,
0 = unknown), `depth/NAME.npz` (float32 metres under "depth"), `confidence/NAME.png` (8-bit, 255 =
1), `labels/NAME.png` (palette, 255 = unlabelled), `preview/NAME.jpg`. Where photos correct
each other (`fusing.py`), `own/depth/NAME.png`, `own/depth/NAME.npz`, `own/confidence/NAME.png` and
`own/labels/NAME.png` are what the network said of this one.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from mvsam.data.files import load_photo
from mvsam.data.labels import ClassTable, png_palette
from mvsam.data.transforms import area_resize
from mvsam.errors import InputError
from mvsam.files import remove_partial_files, writable_folder, write_json, write_whole
from mvsam.geometry.depth_map import from_millimetres, to_millimetres
from mvsam.geometry.pose import OPENCV_FROM_OPENGL
from mvsam.inference.pictures import preview
from mvsam.reconstruction.fusion import PhotoMaps
from mvsam.types import Frame

FILES = {
    "color": "color/{}.jpg",
    "depth": "depth/{}.png",
    "depth_float": "depth/{}.npz",
    "confidence": "confidence/{}.png",
    "labels": "labels/{}.png",
    "own_depth": "own/depth/{}.png",
    "own_depth_float": "own/depth/{}.npz",
    "own_confidence": "own/confidence/{}.png",
    "own_labels": "own/labels/{}.png",
    "preview": "preview/{}.jpg",
}
"""Kind of map -> its file; the preview comes last and is written last."""
_FOLDERS = sorted({Path(pattern).parts[0] for pattern in FILES.values()})

_OWN = {kind: f"own_{kind}" for kind in ("depth", "depth_float", "confidence", "labels")}
"""Kind of map that neighbours correct -> the kind of file that keeps what the network said."""
_MAP_OF = {own: kind for kind, own in _OWN.items()}

INDEX_FILES = ("transforms.json", "classes.json", "metrics.json")

_THUMBNAIL = (8, 6)
"""(width, height), pixels."""
_JPEG_CHANGES = 0.03
"""Of full brightness: more than JPEG changes the mean of a thumbnail's pixel."""

NERFSTUDIO_KEYS = {
    "depth": "depth_file_path",
    "confidence": "confidence_file_path",
    "labels": "label_file_path",
}


@dataclass(frozen=True)
class PhotoPrediction:
    """What a model says about one photo, at the photo's size; a task it does not have is None."""

    depth: Float[np.ndarray, "height width"] | None
    """float32, metres along the optical axis."""
    confidence: Float[np.ndarray, "height width"] | None
    """float32, 0..1."""
    labels: UInt8[np.ndarray, "height width"] | None
    """0..K-1."""

    def kinds(self, save_npz: bool, fuse: bool) -> list[str]:
        """The kinds of files that hold it, keys of `FILES`.

        fuse: whether neighbours are to correct its maps, so that it takes files for its own too.
        """
        present = {
            "color": True,
            "depth": self.depth is not None,
            "depth_float": self.depth is not None and save_npz,
            "confidence": self.confidence is not None,
            "labels": self.labels is not None,
            "preview": True,
        }
        if fuse and present["depth"] and present["confidence"]:
            present |= {own: present[kind] for kind, own in _OWN.items()}
        return [kind for kind in FILES if present.get(kind, False)]


class OutputFolder:
    """Knows what is done, writes what is not.

    `kinds` are the files that every photo of this folder has; they are known from the first
    prediction on, and kept in `run.json` for the next run.
    """

    def __init__(self, path: Path):
        self.path = writable_folder(path)
        self.kinds: list[str] = []

    def file(self, kind: str, name: str) -> Path:
        return self.path / FILES[kind].format(name)

    def is_done(self, name: str) -> bool:
        """Whether every file of this photo exists."""
        return bool(self.kinds) and all(self.file(kind, name).is_file() for kind in self.kinds)

    def shows(self, frame: Frame) -> bool:
        """Whether the copy that was kept of a photo shows what the photo shows today."""
        before, now = load_photo(self.file("color", frame.name)), frame.image
        if before.shape != now.shape:
            return False
        difference = area_resize(before, _THUMBNAIL) - area_resize(now, _THUMBNAIL)
        return float(difference.abs().max()) < _JPEG_CHANGES

    def remove(self, names: Iterable[str]) -> None:
        """Removes all maps of these photos."""
        for name in names:
            for kind in FILES:
                self.file(kind, name).unlink(missing_ok=True)

    def remove_all(self) -> None:
        """Removes everything that a run writes."""
        for pattern in FILES.values():
            for path in self.path.glob(pattern.format("**/*")):
                path.unlink()
        for name in ("run.json", *INDEX_FILES):
            (self.path / name).unlink(missing_ok=True)
        self.kinds = []

    def remove_partial(self) -> None:
        """Removes what a killed run left unfinished; of a folder that is known to be ours."""
        for folder in _FOLDERS:
            remove_partial_files(self.path / folder)

    def check_unused(self) -> None:
        """Raises `InputError` where files that are not ours lie in the way, such as a scene's."""
        for path in (self.path / name for name in (*INDEX_FILES, *_FOLDERS)):
            if path.is_file() or (path.is_dir() and any(path.iterdir())):
                raise InputError(
                    f"{path} exists but was not written by mvsam predict (there is no run.json): "
                    "choose another --out."
                )

    def add_float_depth(self) -> None:
        """From now on photos have it, where they have depth; those without it are not done."""
        for kind in ("depth", "own_depth"):
            if kind in self.kinds and f"{kind}_float" not in self.kinds:
                self.kinds = [*self.kinds, f"{kind}_float"]

    def write_photo(
        self,
        name: str,
        image: UInt8[np.ndarray, "height width 3"],
        prediction: PhotoPrediction,
        classes: ClassTable,
    ) -> None:
        """Writes the maps of one photo, the preview last."""
        self._write(self.kinds, name, image, prediction, classes)

    def maps(self, name: str) -> PhotoMaps:
        """Of one photo that is done, of a model with depth and confidence."""
        return self._read_maps(name, {kind: kind for kind in _OWN})

    def own_maps(self, name: str) -> PhotoMaps:
        """What the network said of it, whatever its neighbours made of that."""
        return self._read_maps(name, _OWN)

    def _read_maps(self, name: str, kinds: dict[str, str]) -> PhotoMaps:
        def read(kind: str) -> np.ndarray:
            with Image.open(self.file(kinds[kind], name)) as picture:
                return np.asarray(picture)

        if kinds["depth_float"] in self.kinds:
            with np.load(self.file(kinds["depth_float"], name)) as stored:
                depth = stored["depth"]
        else:
            depth = from_millimetres(read("depth"))
        labels = read("labels") if "labels" in self.kinds else None
        return PhotoMaps(depth, read("confidence") / np.float32(255), labels)

    def replace_maps(self, name: str, better: PhotoMaps, classes: ClassTable) -> None:
        """Writes what neighbours made of one photo's maps; those in `own/` stay."""
        photo = load_photo(self.file("color", name))
        kinds = [kind for kind in self.kinds if kind in (*_OWN, "preview")]
        self._write(kinds, name, photo, PhotoPrediction(*better), classes)

    def write_index(self, frames: Iterable[Frame], classes: ClassTable) -> None:
        """Writes `transforms.json`, which lists every photo that is done, and `classes.json`.

        Its `is_predicted` keeps readers from taking the maps for the truth.
        """
        entries = [self._entry(frame) for frame in frames if self.is_done(frame.name)]
        index = {"camera_model": "PINHOLE", "depth_unit_scale_factor": 0.001, "is_predicted": True}
        index |= {"frames": entries}
        write_json(self.path / "transforms.json", index)
        if "labels" in self.kinds:
            table = zip(classes.names, classes.colors, strict=True)
            write_json(
                self.path / "classes.json",
                [{"name": name, "color": list(color)} for name, color in table],
            )

    def read_run(self) -> dict[str, Any] | None:
        """What `run.json` says about the run that filled this folder; None without one."""
        path = self.path / "run.json"
        if not path.is_file():
            return None
        try:
            run = json.loads(path.read_text())
            self.kinds = [kind for kind in FILES if kind in run["kinds"]]
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{path} is damaged: choose another --out or remove that folder."
            ) from error
        return run

    def _entry(self, frame: Frame) -> dict[str, Any]:
        (fl_x, _, cx), (_, fl_y, cy), _ = frame.intrinsics.tolist()
        maps = {
            key: FILES[kind].format(frame.name)
            for kind, key in NERFSTUDIO_KEYS.items()
            if kind in self.kinds
        }
        return {
            "file_path": FILES["color"].format(frame.name),
            **{"w": frame.size[0], "h": frame.size[1]},
            **{"fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy},
            "transform_matrix": (frame.world_from_cam @ OPENCV_FROM_OPENGL).tolist(),
            **maps,
        }

    def _write(
        self,
        kinds: Iterable[str],
        name: str,
        image: UInt8[np.ndarray, "height width 3"],
        prediction: PhotoPrediction,
        classes: ClassTable,
    ) -> None:
        pictures = {
            "color": lambda: Image.fromarray(image),
            "depth": lambda: _depth_png(_given(prediction.depth)),
            "confidence": lambda: _confidence_png(_given(prediction.confidence)),
            "labels": lambda: _label_png(_given(prediction.labels), classes),
            "preview": lambda: preview(image, prediction.depth, prediction.labels, classes),
        }
        for kind in kinds:
            path, what = self.file(kind, name), _MAP_OF.get(kind, kind)
            if what == "depth_float":
                self._write_npz(path, _given(prediction.depth))
            else:
                self._write_picture(path, pictures[what]())

    def _write_npz(self, path: Path, depth: np.ndarray) -> None:
        write_whole(path, lambda file: np.savez_compressed(file, depth=depth))

    def _write_picture(self, path: Path, picture: Image.Image) -> None:
        options = {"quality": 95} if path.suffix == ".jpg" else {"compress_level": 4}
        form = "JPEG" if path.suffix == ".jpg" else "PNG"
        write_whole(path, lambda file: picture.save(file, format=form, **options))


def _given(values: np.ndarray | None) -> np.ndarray:
    assert values is not None, "the model stopped giving a map it gave for earlier photos"
    return values


def _depth_png(depth: Float[np.ndarray, "height width"]) -> Image.Image:
    return Image.fromarray(to_millimetres(depth))


def _confidence_png(confidence: Float[np.ndarray, "height width"]) -> Image.Image:
    return Image.fromarray(np.round(np.clip(confidence, 0, 1) * 255).astype(np.uint8))


def _label_png(labels: UInt8[np.ndarray, "height width"], classes: ClassTable) -> Image.Image:
    picture = Image.fromarray(labels)
    picture.putpalette(png_palette(classes))
    return picture
