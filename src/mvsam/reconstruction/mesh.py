"""A labelled surface: its shape from all trusted depths, colours and labels from the cloud."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module

import numpy as np
from jaxtyping import Float, Int

from mvsam.errors import MissingExtraError
from mvsam.reconstruction.cloud import (
    NothingLeft,
    OnPhoto,
    PointCloud,
    VoxelGrid,
    points_of,
    remedy,
    trusted_depths,
)
from mvsam.reconstruction.folder import DepthView
from mvsam.reconstruction.settings import CloudSettings
from mvsam.reconstruction.tsdf import TsdfVolume

FEWEST_TRIANGLES = 100
"""Pieces of the surface with fewer are left out: depths that were wrong twice."""
LIBRARIES = {"skimage.measure": "scikit-image", "scipy.spatial": "scipy", "trimesh": "trimesh"}


@dataclass(frozen=True)
class Mesh:
    """Triangles between coloured, labelled points."""

    vertices: PointCloud
    faces: Int[np.ndarray, "face 3"]
    """Three vertices each, counter-clockwise as the cameras saw them."""


def build_mesh(
    views: Sequence[DepthView],
    settings: CloudSettings,
    on_photo: OnPhoto = lambda name, share: None,
) -> Mesh:
    """The labelled surface of all depths that pass the filters.

    Every vertex takes colour, label and confidence of the nearest point of the cloud.
    Raises `NothingLeft` when there is no surface, and `MissingExtraError`.
    """
    check_libraries()
    grid, volume = VoxelGrid(settings.voxel_size), TsdfVolume(settings.voxel_size)
    for view, depth in trusted_depths(views, settings, on_photo):
        grid.add(points_of(view, depth))
        volume.add(view, depth, np.maximum(view.confidence(), 1e-3))
    vertices, faces = _large_pieces(*volume.surface())
    if not len(faces):
        raise NothingLeft(
            f"no surface is left: {remedy(views, settings)}, or try another --voxel-size"
        )
    return Mesh(_dressed(vertices, grid.cloud()), faces)


def check_libraries() -> None:
    """Raises `MissingExtraError` for the first one that is not installed."""
    for module, library in LIBRARIES.items():
        try:
            import_module(module)
        except ImportError as error:
            raise MissingExtraError("a mesh", library, "reconstruct") from error


def _large_pieces(
    vertices: Float[np.ndarray, "_ 3"], faces: Int[np.ndarray, "_ 3"]
) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """The same surface with each vertex once, without specks."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    if not len(mesh.faces):
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    piece = trimesh.graph.connected_component_labels(mesh.face_adjacency, len(mesh.faces))
    mesh.update_faces(np.bincount(piece)[piece] >= FEWEST_TRIANGLES)
    mesh.remove_unreferenced_vertices()
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def _dressed(vertices: Float[np.ndarray, "vertex 3"], cloud: PointCloud) -> PointCloud:
    """The vertices with what the cloud says at its nearest points."""
    from scipy.spatial import KDTree

    _, nearest = KDTree(cloud.points).query(vertices)
    return replace(
        cloud,
        points=vertices.astype(np.float32),
        colors=cloud.colors[nearest],
        labels=cloud.labels[nearest],
        confidence=cloud.confidence[nearest],
    )
