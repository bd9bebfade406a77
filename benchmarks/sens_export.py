"""Frames of a `.sens` that one core exports a second, and how fast zlib and JPEG decode alone.

    OMP_NUM_THREADS=1 python benchmarks/sens_export.py --out results/sens_export.json

The scan is made up: a photo-like picture of 1296x968 as JPEG (quality 90) and depth of 640x480 with
sensor noise, as ScanNet has them. Seconds are those of the processor, of one process.
"""

import argparse
import io
import json
import tempfile
import time
import zlib
from pathlib import Path

import numpy as np
from PIL import Image

from mvsam.data.readers.sens import SensFile
from mvsam.data.scannet_export import export, plan
from mvsam.provenance import provenance

COLOR, DEPTH = (1296, 968), (640, 480)


def write_scan(path: Path, num_frames: int) -> None:
    """A scan in the published layout; frames differ by noise."""
    from struct import pack

    dice = np.random.default_rng(0)
    smooth = Image.fromarray(dice.integers(0, 255, (24, 32, 3), dtype=np.uint8))
    photo = np.asarray(smooth.resize(COLOR, Image.Resampling.BICUBIC)).astype(float)
    identity = np.eye(4, dtype="<f4").tobytes()
    color = np.array([[1170, 0, 648, 0], [0, 1170, 484, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "<f4")
    depth = np.array([[577, 0, 320, 0], [0, 577, 240, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "<f4")
    with path.open("wb") as file:
        file.write(pack("<IQ", 4, 4) + b"made" + color.tobytes() + identity)
        file.write(depth.tobytes() + identity + pack("<ii", 2, 1))
        file.write(pack("<IIIIfQ", *COLOR, *DEPTH, 1000.0, num_frames))
        for number in range(num_frames):
            noisy = (photo + dice.normal(0, 6, photo.shape)).clip(0, 255).astype(np.uint8)
            jpeg = io.BytesIO()
            Image.fromarray(noisy).save(jpeg, "JPEG", quality=90)
            plane = 1500 + np.add.outer(np.arange(DEPTH[1]), np.arange(DEPTH[0])) * 0.7
            values = (plane + dice.normal(0, 3, plane.shape)).astype("<u2")
            values[:20] = 0
            packed = zlib.compress(values.tobytes())
            file.write(identity + pack("<QQQQ", number, number, jpeg.tell(), len(packed)))
            file.write(jpeg.getvalue() + packed)


def decode_alone(scan: SensFile) -> None:
    for index in range(len(scan.frames)):
        with Image.open(io.BytesIO(scan.color_file(index))) as picture:
            picture.load()
        scan.depth_pixels(index)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    rates = {}
    with tempfile.TemporaryDirectory() as work:
        scan = Path(work) / "scan"
        scan.mkdir()
        write_scan(scan / "scan.sens", arguments.frames)
        source = SensFile(scan / "scan.sens")
        for name, task in (
            ("decoding alone", lambda: decode_alone(source)),
            ("export as stored", lambda: list(export(plan(scan, scan / "a")[0], 1))),
            (
                "export at 640x480",
                lambda: list(export(plan(scan, scan / "b", size=DEPTH)[0], 1)),
            ),
        ):
            start = time.process_time()
            task()
            rates[name] = arguments.frames / (time.process_time() - start)
            print(f"{name:20} {rates[name]:6.1f} frames a second of one core")
    if arguments.out:
        record = {"frames": arguments.frames, "frames_per_core_second": rates, **provenance()}
        arguments.out.write_text(json.dumps(record, indent=2) + "\n")


if __name__ == "__main__":
    main()
