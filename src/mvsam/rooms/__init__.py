"""The procedural world: furnished rooms with exact depth, labels and cameras."""

from .export import export_posed_folder, preview_sheet
from .room import Room
from .scene import SPLITS, RoomScene, scene

__all__ = ["SPLITS", "Room", "RoomScene", "export_posed_folder", "preview_sheet", "scene"]
