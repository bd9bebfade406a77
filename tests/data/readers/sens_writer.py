"""Writes ScanNet's raw form as its SensReader documents it, for the tests."""

import io
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
from PIL import Image


def write_sens(
    path: Path,
    images: list[np.ndarray],
    depths: list[np.ndarray],
    poses: list[np.ndarray],
    color_matrix: np.ndarray,
    depth_matrix: np.ndarray,
    quality: int = 95,
) -> None:
    """Depths in metres; matrices with integer pixel centres."""
    height, width = images[0].shape[:2]
    rows, columns = depths[0].shape
    name = b"StructureSensor"
    with path.open("wb") as file:
        file.write(struct.pack("<IQ", 4, len(name)) + name)
        for matrix in (color_matrix, None, depth_matrix, None):
            full = np.eye(4, dtype="<f4")
            if matrix is not None:
                full[:3, :3] = matrix
            file.write(full.tobytes())
        file.write(struct.pack("<ii", 2, 1))
        file.write(struct.pack("<IIIIfQ", width, height, columns, rows, 1000.0, len(images)))
        for index, (image, depth, pose) in enumerate(zip(images, depths, poses, strict=True)):
            buffer = io.BytesIO()
            Image.fromarray(image).save(buffer, "JPEG", quality=quality, subsampling=0)
            packed = zlib.compress(np.rint(depth * 1000).astype("<u2").tobytes())
            file.write(pose.astype("<f4").tobytes())
            file.write(struct.pack("<QQQQ", index, index, buffer.tell(), len(packed)))
            file.write(buffer.getvalue() + packed)


def write_label_zip(path: Path, raw_ids: list[np.ndarray]) -> None:
    """16-bit PNGs of raw category ids, named by frame."""
    with zipfile.ZipFile(path, "w") as archive:
        for index, ids in enumerate(raw_ids):
            buffer = io.BytesIO()
            Image.fromarray(ids.astype(np.uint16)).save(buffer, "PNG")
            archive.writestr(f"label-filt/{index}.png", buffer.getvalue())


def write_tsv(path: Path) -> None:
    """A few rows of ScanNet's table: raw id 1 wall, 2 chair, 3 floor, 99 a lamp (no class)."""
    rows = ["id\traw_category\tnyu40id", "1\twall\t1", "2\tchair\t5", "3\tfloor\t2", "99\tlamp\t35"]
    path.write_text("\n".join(rows))
