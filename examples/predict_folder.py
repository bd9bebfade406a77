"""Depth and labels of a posed folder through the Python interface.

    python examples/predict_folder.py my_room --out depth_and_labels

Reads the files by itself, to show what `mvsam.predict` takes; `mvsam predict` does all of this, and
chooses among more than eight photos which ones to look at together.
"""

import argparse
from pathlib import Path

import numpy as np
from PIL import Image

import mvsam
from mvsam.data import colorize

SAMPLE = Path(mvsam.__path__[0]) / "assets" / "sample"


def read_photos(folder: Path, most: int) -> tuple[list[str], list, list, list]:
    """Names, images, intrinsics and poses of the first photos of a posed folder."""
    paths = sorted((folder / "color").iterdir())[:most]
    images = [np.array(Image.open(path).convert("RGB")) for path in paths]
    intrinsics = [np.loadtxt(folder / "intrinsics.txt")] * len(paths)  # as OpenCV calibrates
    poses = [np.loadtxt(folder / "poses" / f"{path.stem}.txt") for path in paths]
    return [path.stem for path in paths], images, intrinsics, poses


def main() -> None:
    parser = argparse.ArgumentParser(description="Depth and labels of a posed folder.")
    parser.add_argument("folder", type=Path, nargs="?", default=SAMPLE)
    parser.add_argument("--model", default="tiny", help="name, path of weights, or hub id")
    parser.add_argument("--photos", type=int, default=5, help="look at so many together, 2 to 8")
    parser.add_argument("--depth-range", type=float, nargs=2, default=(0.1, 5.0), help="metres")
    parser.add_argument("--out", type=Path, default=Path("out/example"))
    arguments = parser.parse_args()

    names, images, intrinsics, world_from_cam = read_photos(arguments.folder, arguments.photos)
    model = mvsam.load(arguments.model)
    near, far = arguments.depth_range
    results = mvsam.predict(model, images, intrinsics, world_from_cam, depth_range=(near, far))

    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, result in zip(names, results, strict=True):
        assert result.depth is not None and result.labels is not None  # tiny does both tasks
        np.save(arguments.out / f"{name}_depth.npy", result.depth)  # float32 metres
        Image.fromarray(colorize(result.labels)).save(arguments.out / f"{name}_labels.png")
        print(f"{name}: median depth {np.median(result.depth):.2f} m")


if __name__ == "__main__":
    main()
