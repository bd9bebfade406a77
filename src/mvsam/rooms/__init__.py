"""The procedural world: furnished rooms with exact depth, labels and cameras."""

from .preview import preview_sheet
from .room import Room
from .scene import SPLITS, VERSION, RoomScene, scene

__all__ = [
    "SPLITS",
    "VERSION",
    "Room",
    "RoomScene",
    "preview_sheet",
    "scene",
]
