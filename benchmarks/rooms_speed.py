"""Frames a second that one core renders, with room building and camera search included.

OMP_NUM_THREADS=1 python benchmarks/rooms_speed.py --rooms 10 --out results/rooms_speed.json
"""

import argparse
import json
import time
from pathlib import Path

from mvsam import rooms
from mvsam.provenance import provenance


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rooms", type=int, default=10, help="rooms of rooms:val")
    parser.add_argument("--frames", type=int, default=5, help="of each room")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    start = time.process_time()
    for index in range(arguments.rooms):
        scene = rooms.scene("val", index, arguments.frames)
        for frame in range(arguments.frames):
            _ = scene.frame(frame).image
    seconds = time.process_time() - start
    num_frames = arguments.rooms * arguments.frames
    rate = num_frames / seconds
    print(
        f"{num_frames} frames of 320x256 in {seconds:.1f} s of processor time: {rate:.1f} a second"
    )
    if arguments.out:
        record = {"frames": num_frames, "frames_per_core_second": rate, **provenance()}
        arguments.out.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
