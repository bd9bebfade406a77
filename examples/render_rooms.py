"""Procedural rooms as posed folders, and one picture of them all.

    python examples/render_rooms.py --rooms rooms:val:0-2 --out out/rooms

The folders have true depth and labels, so `mvsam predict` on them writes scores too.
"""

import argparse
from pathlib import Path

import numpy as np

from mvsam.data import SCANNET20, open_data
from mvsam.data.convert import write_posed_folder
from mvsam.rooms import preview_sheet


def main() -> None:
    parser = argparse.ArgumentParser(description="Render procedural rooms.")
    parser.add_argument("--rooms", default="rooms:val:0-2", help="rooms:SPLIT:FIRST-END")
    parser.add_argument("--frames", type=int, default=5, help="photos of each room")
    parser.add_argument("--out", type=Path, default=Path("out/rooms"))
    arguments = parser.parse_args()

    rooms = list(open_data(arguments.rooms, room_frames=arguments.frames))
    for room in rooms:
        folder = arguments.out / Path(room.name).name
        list(write_posed_folder(room, folder, "PNG"))
        print(f"{room.name}: {len(room)} photos in {folder}")
    sheet = preview_sheet(rooms, np.array(SCANNET20.colors, np.uint8))
    sheet.save(arguments.out / "preview.png")
    print(f"photo, depth and labels of each: {arguments.out / 'preview.png'}")


if __name__ == "__main__":
    main()
