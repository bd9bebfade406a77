"""Point clouds and meshes as files: PLY written by hand, GLB through trimesh."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
from jaxtyping import Int, UInt8

from mvsam.errors import InputError, MissingExtraError
from mvsam.files import write_whole
from mvsam.reconstruction.cloud import PointCloud
from mvsam.reconstruction.mesh import Mesh

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
PLY_FACE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])
PLY_TYPES = {"<f4": "float", "|u1": "uchar"}

Model3D = PointCloud | Mesh


def colored_by_label(model: Model3D, palette: UInt8[np.ndarray, "256 3"]) -> Model3D:
    """The same in the colours of its classes."""
    if isinstance(model, Mesh):
        return replace(model, vertices=colored_by_label(model.vertices, palette))
    return replace(model, colors=palette[model.labels])


def write_model(path: Path, model: Model3D) -> None:
    """Writes `.ply` or `.glb`, as the ending of `path` says; raises what `check_target` does."""
    check_target(path)
    writers = {".ply": write_ply, ".glb": write_glb}
    writers[path.suffix.lower()](path, model)


def check_target(path: Path) -> None:
    """Raises `InputError` where no model can be written, `MissingExtraError` without trimesh."""
    if path.suffix.lower() not in (".ply", ".glb"):
        raise InputError(f"{path} must end in .ply or .glb.")
    if path.is_dir():
        raise InputError(f"{path} is a folder: choose another --out.")
    if path.suffix.lower() == ".glb":
        try:
            import_module("trimesh")
        except ImportError as error:
            raise MissingExtraError("GLB export", "trimesh", "reconstruct") from error


def write_ply(path: Path, model: Model3D) -> None:
    """Binary little-endian PLY: x y z (metres), red green blue, label (255 = none), confidence.

    Of a mesh then its triangles: the number 3 and three vertices.
    """
    cloud, faces = _parts(model)
    corners = np.empty(len(faces), PLY_FACE)
    corners["count"], corners["vertices"] = 3, faces
    content = _ply_header(len(cloud), len(faces)) + _ply_vertices(cloud) + corners.tobytes()
    write_whole(path, lambda file: file.write(content))


def _parts(model: Model3D) -> tuple[PointCloud, Int[np.ndarray, "face 3"]]:
    if isinstance(model, Mesh):
        return model.vertices, model.faces
    return model, np.empty((0, 3), np.int64)


def _ply_vertices(cloud: PointCloud) -> bytes:
    vertices = np.empty(len(cloud), PLY_VERTEX)
    for axis, name in enumerate(("x", "y", "z")):
        vertices[name] = cloud.points[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = cloud.colors[:, channel]
    vertices["label"] = cloud.labels
    vertices["confidence"] = cloud.confidence
    return vertices.tobytes()


def _ply_header(num_points: int, num_faces: int) -> bytes:
    properties = [
        f"property {PLY_TYPES[PLY_VERTEX[name].str]} {name}" for name in PLY_VERTEX.names or ()
    ]
    of_faces = [f"element face {num_faces}", "property list uchar int vertex_indices"]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment metres; label 255 = none",
        f"element vertex {num_points}",
        *properties,
        *(of_faces if num_faces else []),
        "end_header",
    ]
    return ("\n".join(lines) + "\n").encode()


def write_glb(path: Path, model: Model3D) -> None:
    """Binary glTF with vertex colours, shown as they are (unlit); labels and confidence need PLY.

    Coordinates stay those of the scene; glTF viewers take +y for up.
    """
    import trimesh

    cloud, faces = _parts(model)
    colors = linear_light(cloud.colors)
    if len(faces):
        shape = trimesh.Trimesh(cloud.points, faces, vertex_colors=colors, process=False)
    else:
        shape = trimesh.PointCloud(cloud.points, colors=colors)
    content = trimesh.Scene([shape]).export(file_type="glb", tree_postprocessor=_unlit)
    assert isinstance(content, bytes)
    write_whole(path, lambda file: file.write(content))


def linear_light(colors: UInt8[np.ndarray, "*any 3"]) -> UInt8[np.ndarray, "*any 3"]:
    """Of sRGB colours, as glTF wants those of vertices; eight bits are coarse in the dark."""
    share = colors / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return np.round(255 * linear).astype(np.uint8)


def _unlit(tree: dict) -> None:
    """Light is in the photos already; glTF's own material is a dark metal."""
    plain = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    unlit = {"KHR_materials_unlit": {}}
    tree["materials"] = [{"pbrMetallicRoughness": plain, "doubleSided": True, "extensions": unlit}]
    tree["extensionsUsed"] = [*tree.get("extensionsUsed", []), *unlit]
    for mesh in tree["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["material"] = 0
