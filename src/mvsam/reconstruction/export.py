"""Point clouds as files: PLY written by hand, GLB through trimesh."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from mvsam.errors import InputError, MissingExtraError
from mvsam.files import write_whole
from mvsam.reconstruction.cloud import PointCloud

PLY_VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("label", "u1"),
        ("confidence", "<f4"),
    ]
)
PLY_TYPES = {"<f4": "float", "|u1": "uchar"}


def colored_by_label(cloud: PointCloud, palette: UInt8[np.ndarray, "256 3"]) -> PointCloud:
    """The same points in the colours of their classes."""
    return replace(cloud, colors=palette[cloud.labels])


def write_cloud(path: Path, cloud: PointCloud) -> None:
    """Writes `.ply` or `.glb`, as the ending of `path` says."""
    writers = {".ply": write_ply, ".glb": write_glb}
    if path.suffix.lower() not in writers:
        raise InputError(f"{path} must end in .ply or .glb")
    writers[path.suffix.lower()](path, cloud)


def write_ply(path: Path, cloud: PointCloud) -> None:
    """Binary little-endian PLY: x y z (metres), red green blue, label (255 = none), confidence."""
    vertices = np.empty(len(cloud), PLY_VERTEX)
    for axis, name in enumerate(("x", "y", "z")):
        vertices[name] = cloud.points[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = cloud.colors[:, channel]
    vertices["label"] = cloud.labels
    vertices["confidence"] = cloud.confidence
    write_whole(path, lambda file: file.write(_ply_header(len(cloud)) + vertices.tobytes()))


def _ply_header(num_points: int) -> bytes:
    properties = [
        f"property {PLY_TYPES[PLY_VERTEX[name].str]} {name}" for name in PLY_VERTEX.names or ()
    ]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres; label 255 = none",
        f"element vertex {num_points}",
        *properties,
        "end_header",
    ]
    return ("\n".join(lines) + "\n").encode()


def write_glb(path: Path, cloud: PointCloud) -> None:
    """Binary glTF with vertex colours; labels and confidence need PLY.

    Coordinates stay those of the scene; glTF viewers take +y for up.
    """
    try:
        import trimesh
    except ImportError as error:
        raise MissingExtraError("GLB export", "trimesh", "reconstruct") from error
    points = trimesh.PointCloud(cloud.points, colors=cloud.colors)
    content = trimesh.Scene([points]).export(file_type="glb")
    assert isinstance(content, bytes)
    write_whole(path, lambda file: file.write(content))
