"""The procedural world: furnished rooms with exact depth, labels and cameras."""

from .export import export_posed_folder, preview_sheet
from .room import Room
from .scene import SPLITS, VERSION, RoomScene, scene

__all__ = [
    "SPLITS",
    "VERSION",
    "Room",
    "RoomScene",
    "export_posed_folder",
    "preview_sheet",
    "scene",
]
