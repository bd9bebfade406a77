"""Depth and labels from an exported file with NumPy, ONNX Runtime and Pillow: no torch, no mvsam.

    mvsam export tiny --out tiny.onnx
    python examples/onnx_predict.py tiny.onnx my_room --out depth_and_labels

Looks at the first three photos of a posed folder together and writes the maps of the first.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import onnxruntime
from PIL import Image


def main() -> None:
    parser = argparse.ArgumentParser(description="Depth and labels from an exported file.")
    parser.add_argument("model", type=Path)
    parser.add_argument("folder", type=Path, help="color/, poses/ and intrinsics.txt")
    parser.add_argument("--out", type=Path, default=Path("out/onnx"))
    arguments = parser.parse_args()

    session = onnxruntime.InferenceSession(arguments.model, providers=["CPUExecutionProvider"])
    about = {k: json.loads(v) for k, v in session.get_modelmeta().custom_metadata_map.items()}
    width, height = about["input_size"]
    calibration = np.loadtxt(arguments.folder / "intrinsics.txt")
    calibration[:2, 2] += 0.5  # OpenCV counts pixel centres at integers, the network at halves

    images, intrinsics, poses = [], [], []
    for path in sorted((arguments.folder / "color").iterdir())[:3]:
        with Image.open(path) as file:
            photo = file.convert("RGB")
        resized = photo.resize((width, height), Image.Resampling.BILINEAR)
        images.append(np.asarray(resized).transpose(2, 0, 1) / 255)
        intrinsics.append(calibration * [[width / photo.width], [height / photo.height], [1]])
        poses.append(np.loadtxt(arguments.folder / "poses" / f"{path.stem}.txt"))

    given = {"images": [images], "intrinsics": [intrinsics], "world_from_cam": [poses]}
    given["depth_range"] = [about["depth_range"]]
    inputs = {name: np.asarray(values, np.float32) for name, values in given.items()}
    depth, labels = map(np.asarray, session.run(["depth", "labels"], inputs))

    arguments.out.mkdir(parents=True, exist_ok=True)
    np.save(arguments.out / "depth.npy", depth[0])  # float32 metres
    palette = np.array(about["palette"], np.uint8)
    Image.fromarray(palette[labels[0]]).save(arguments.out / "labels.png")
    print(f"median depth {np.median(depth):.2f} m; classes: ", end="")
    print(*(about["classes"][label] for label in np.unique(labels)), sep=", ")


if __name__ == "__main__":
    main()
