"""Readers, one per format, and what turns frames into a model's input."""

from mvsam.data.catalog import open_data
from mvsam.data.check.poses import pose_convention_hint
from mvsam.data.dataset import TupleDataset, collate, make_targets, make_views
from mvsam.data.formats import open_scene
from mvsam.data.labels import SCANNET20, ClassTable, colorize, png_palette
from mvsam.data.readers.posed_folder import PosedFolder
from mvsam.data.sampling import view_tuples

__all__ = [
    "SCANNET20",
    "ClassTable",
    "PosedFolder",
    "TupleDataset",
    "collate",
    "colorize",
    "make_targets",
    "make_views",
    "open_data",
    "open_scene",
    "png_palette",
    "pose_convention_hint",
    "view_tuples",
]
