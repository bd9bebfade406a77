"""Writers of frames in every format's published layout, for the tests.

Each takes frames and an empty folder; scenes are then opened from that folder.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

from mvsam.data import convert
from mvsam.data.nyu40 import NYU40_IDS, TSV
from mvsam.data.readers import icl_nuim, seven_scenes
from mvsam.types import IGNORE, Frame
from tests.data.readers.sens_writer import write_label_zip, write_sens
from tests.synthetic import depth_of, labels_of

CENTRES = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
OPENGL = np.diag([1.0, -1, -1, 1])
FREE = (160, 120)
RAW_OFFSET = 1000
"""Raw category id of NYU40's class n is 1000 + n in our table."""


class Listed:
    """Frames as a scene, for our own converters."""

    name = "listed"

    def __init__(self, frames: Sequence[Frame]):
        self.frames = frames

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, index: int) -> Frame:
        return self.frames[index]

    def views(self) -> None:
        return None


def save(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path, quality=97, subsampling=0)  # PNG takes no notice of them


def save_depth(path: Path, depth: np.ndarray, units: float = 1000) -> None:
    save(path, np.rint(depth * units).astype(np.uint16))


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """(x, y, z, w) of a rotation, as the eigenvector of its symmetric form (Bar-Itzhack)."""
    r = rotation
    form = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r.trace()],
        ]
    )
    return np.linalg.eigh(form / 3)[1][:, 3]


def tum_line(stamp: str, pose: np.ndarray) -> str:
    values = [*pose[:3, 3], *quaternion(pose[:3, :3])]
    return " ".join([stamp, *(f"{value:.9f}" for value in values)])


def write_lines(path: Path, lines: Sequence[str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def write_posed(frames: Sequence[Frame], path: Path) -> None:
    list(convert.write_posed_folder(Listed(frames), path, "PNG"))


def write_views_and_classes(path: Path) -> None:
    """What a posed folder may have besides."""
    names = [file.stem for file in sorted((path / "color").iterdir())]
    write_lines(path / "views.txt", ["# reference, then sources", " ".join(names)])
    table = [{"name": f"class {n}", "color": [n, 0, 255]} for n in range(len(NYU40_IDS))]
    (path / "classes.json").write_text(json.dumps(table))


def write_nerfstudio(frames: Sequence[Frame], path: Path) -> None:
    list(convert.write_nerfstudio(Listed(frames), path, "PNG"))


def write_colmap(frames: Sequence[Frame], path: Path) -> None:
    k, (width, height) = frames[0].intrinsics, frames[0].size
    numbers = " ".join(f"{value:.17g}" for value in (k[0, 0], k[1, 1], k[0, 2], k[1, 2]))
    write_lines(path / "sparse/0/cameras.txt", [f"1 PINHOLE {width} {height} {numbers}"])
    lines = []
    for number, frame in enumerate(frames, start=1):
        pose = np.linalg.inv(frame.world_from_cam)
        x, y, z, w = quaternion(pose[:3, :3])
        values = " ".join(f"{value:.17g}" for value in (w, x, y, z, *pose[:3, 3]))
        lines += [f"{number} {values} 1 {frame.name}.png", ""]
        save(path / f"images/{frame.name}.png", frame.image)
        save_depth(path / f"depth/{frame.name}.png", depth_of(frame))
    write_lines(path / "sparse/0/images.txt", lines)
    write_lines(path / "sparse/0/points3D.txt", ["# none"])


def raw_ids(frame: Frame) -> np.ndarray:
    """ScanNet's category ids of the labels, by the table that `write_table` writes."""
    table = np.zeros(256, np.uint16)
    table[: len(NYU40_IDS)] = np.array(NYU40_IDS) + RAW_OFFSET
    assert table[IGNORE] == 0
    return table[labels_of(frame)]


def write_table(folder: Path) -> None:
    rows = [f"{RAW_OFFSET + n}\tthing\t{n}" for n in range(1, 41)]
    write_lines(folder / TSV, ["id\traw_category\tnyu40id", *rows])


def write_scannet(frames: Sequence[Frame], path: Path, intrinsics: str = "intrinsic/intrinsic_{}"):
    matrix = np.eye(4)
    matrix[:3, :3] = frames[0].intrinsics - CENTRES
    for camera in ("color", "depth"):
        file = path / (intrinsics.format(camera) + ".txt")
        file.parent.mkdir(parents=True, exist_ok=True)
        np.savetxt(file, matrix, fmt="%.9g")
    for number, frame in enumerate(frames):
        save(path / f"color/{number}.jpg", frame.image)
        save_depth(path / f"depth/{number}.png", depth_of(frame))
        save(path / f"label-filt/{number}.png", raw_ids(frame))
        (path / "pose").mkdir(exist_ok=True)
        np.savetxt(path / f"pose/{number}.txt", frame.world_from_cam, fmt="%.6f")
    write_table(path)


def write_25k(frames: Sequence[Frame], path: Path) -> None:
    """scannet_frames_25k: calibrations beside the folders, labels as NYU40 ids in 8 bits."""
    write_scannet(frames, path, "intrinsics_{}")
    (path / "label-filt").rename(path / "label")
    for number, frame in enumerate(frames):
        ids = raw_ids(frame)
        save(path / f"label/{number}.png", np.where(ids, ids - RAW_OFFSET, 0).astype(np.uint8))


def write_raw_scan(frames: Sequence[Frame], path: Path) -> None:
    matrix = frames[0].intrinsics - CENTRES
    path.mkdir(parents=True, exist_ok=True)
    write_sens(
        path / "scan.sens",
        [frame.image for frame in frames],
        [depth_of(frame) for frame in frames],
        [frame.world_from_cam for frame in frames],
        matrix,
        matrix,
        quality=97,
    )
    write_label_zip(path / "scan_2d-label-filt.zip", [raw_ids(frame) for frame in frames])
    write_table(path)


def write_tum(frames: Sequence[Frame], path: Path) -> None:
    stamps = [f"{1305031102 + number / 30:.6f}" for number in range(len(frames))]
    for stamp, frame in zip(stamps, frames, strict=True):
        save(path / f"rgb/{stamp}.png", frame.image)
        save_depth(path / f"depth/{stamp}.png", depth_of(frame), 5000)
    for kind in ("rgb", "depth"):
        write_lines(path / f"{kind}.txt", [f"{stamp} {kind}/{stamp}.png" for stamp in stamps])
    pairs = zip(stamps, frames, strict=True)
    write_lines(path / "groundtruth.txt", [tum_line(s, f.world_from_cam) for s, f in pairs])
    np.savetxt(path / "intrinsics.txt", frames[0].intrinsics - CENTRES, fmt="%.9f")


def write_icl(frames: Sequence[Frame], path: Path) -> None:
    mirror = np.diag([1.0, -1, 1, 1])
    lines = []
    for number, frame in enumerate(frames, start=1):
        save(path / f"rgb/{number}.png", frame.image)
        save_depth(path / f"depth/{number}.png", depth_of(frame), 5000)
        lines.append(tum_line(str(number), mirror @ frame.world_from_cam @ mirror))
    save(path / "rgb/0.png", frames[0].image)  # the published sets have no pose for it
    write_lines(path / "livingRoom2.gt.freiburg", lines)


def write_seven_scenes(frames: Sequence[Frame], path: Path) -> None:
    """`load_depth` of these frames is the depth camera's; unknown depth is 65535."""
    for number, frame in enumerate(frames):
        stem = path / f"frame-{number:06d}"
        save(stem.with_suffix(".color.png"), frame.image)
        pixels = np.rint(1000 * depth_of(frame)).astype(np.uint16)
        save(stem.with_suffix(".depth.png"), np.where(pixels == 0, 65535, pixels).astype(np.uint16))
        pose = frame.world_from_cam @ seven_scenes.COLOR_FROM_DEPTH
        np.savetxt(stem.with_suffix(".pose.txt"), pose, fmt="%.9f")


def write_ios_logger(
    frames: Sequence[Frame], path: Path, folder: str = "frames", every: int = 1
) -> None:
    """A picture every 1/60 s, a pose between each two."""
    shots, poses = [], []
    for index, frame in enumerate(frames):
        number, k = index * every, frame.intrinsics
        # ARKit calibrates the full video; the pictures here are smaller.
        full = [k[0, 0] * 12, k[1, 1] * 12, k[0, 2] * 12, k[1, 2] * 12]
        values = ", ".join(f"{value:.8f}" for value in full)
        shots.append(f"{100 + number / 60:.6f}, {number}, {values}")
        pose = frame.world_from_cam @ OPENGL
        x, y, z, w = quaternion(pose[:3, :3])
        values = ", ".join(f"{value:.9f}" for value in (*pose[:3, 3], w, x, y, z))
        poses.append(f"{100.004 + number / 60:.6f}, {values}")
        if folder:
            save(path / folder / f"{number:06d}.jpg", frame.image)
    write_lines(path / "Frames.txt", shots)
    write_lines(path / "ARposes.txt", poses)


def write_arkitscenes(frames: Sequence[Frame], path: Path) -> None:
    folder, lines = path / f"{path.name}_frames", []
    for number, frame in enumerate(frames):
        stem = f"{path.name}_{4300 + number / 60:.3f}"
        save(folder / f"lowres_wide/{stem}.png", frame.image)
        save_depth(folder / f"lowres_depth/{stem}.png", depth_of(frame))
        k, (width, height) = frame.intrinsics, frame.size
        values = " ".join(f"{value:.9g}" for value in (k[0, 0], k[1, 1], k[0, 2], k[1, 2]))
        camera = folder / f"lowres_wide_intrinsics/{stem}.pincam"
        write_lines(camera, [f"{width} {height} {values}"])
        pose = np.linalg.inv(frame.world_from_cam)
        *axis, cosine = quaternion(pose[:3, :3])
        sine = float(np.linalg.norm(axis))
        vector = 2 * np.arctan2(sine, cosine) * np.array(axis) / max(sine, 1e-12)
        values = " ".join(f"{value:.9f}" for value in (*vector, *pose[:3, 3]))
        lines.append(f"{4300.001 + number / 60:.6f} {values}")
    write_lines(folder / "lowres_wide.traj", lines)


def write_replica(frames: Sequence[Frame], path: Path) -> None:
    lines = []
    for number, frame in enumerate(frames):
        save(path / f"results/frame{number:06d}.jpg", frame.image)
        save_depth(path / f"results/depth{number:06d}.png", depth_of(frame), 6553.5)
        lines.append(" ".join(f"{value:.9f}" for value in frame.world_from_cam.ravel()))
    write_lines(path / "traj.txt", lines)
    k = frames[0].intrinsics - CENTRES
    camera = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], "scale": 6553.5}
    (path / "cam_params.json").write_text(json.dumps({"camera": camera}))


@dataclass(frozen=True)
class Layout:
    """How a format is written, and how exactly it keeps what."""

    write: Callable[[Sequence[Frame], Path], None]
    is_lossless: bool = True
    depth_step: float | None = 1e-3
    """Metres between two depths of the format; None: it has none."""
    has_labels: bool = False
    pose_step: float = 1e-6
    camera: Float[np.ndarray, "3 3"] | None = None
    """The one camera of a data set; None: any."""
    size: tuple[int, int] = FREE


LAYOUTS = {
    "posed-folder": Layout(write_posed, has_labels=True),
    "nerfstudio": Layout(write_nerfstudio, has_labels=True),
    "colmap": Layout(write_colmap),
    "scannet": Layout(write_scannet, False, has_labels=True),
    "scannet 25k": Layout(write_25k, False, has_labels=True),
    "scannet-sens": Layout(write_raw_scan, False, has_labels=True),
    "tum": Layout(write_tum, depth_step=2e-4),
    "icl-nuim": Layout(write_icl, depth_step=2e-4, camera=icl_nuim.CAMERA, size=(640, 480)),
    "7-scenes": Layout(write_seven_scenes, camera=seven_scenes.COLOR_CAMERA, size=(640, 480)),
    "ios-logger": Layout(write_ios_logger, False, depth_step=None),
    "arkitscenes": Layout(write_arkitscenes),
    "replica": Layout(write_replica, False, depth_step=1 / 6553.5),
}
