"""Reads what trimesh leaves out of a GLB file."""

import json
from pathlib import Path

import numpy as np


def glb_tree(path: Path) -> dict:
    """Its JSON."""
    content = path.read_bytes()
    return json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])


def glb_colors(path: Path) -> np.ndarray:
    """Four bytes a vertex, of the first mesh."""
    tree, content = glb_tree(path), path.read_bytes()
    (primitive,) = tree["meshes"][0]["primitives"]
    accessor = tree["accessors"][primitive["attributes"]["COLOR_0"]]
    start = 28 + int.from_bytes(content[12:16], "little")
    start += tree["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
    values = np.frombuffer(content, np.uint8, 4 * accessor["count"], start)
    return values.reshape(-1, 4)
