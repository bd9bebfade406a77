"""From NYU's 40 classes, and ScanNet's raw categories, to the 20 of the ScanNet benchmark."""

import csv
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Integer, UInt8

from mvsam.errors import InputError
from mvsam.types import IGNORE

NYU40_IDS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 24, 28, 33, 34, 36, 39)
"""NYU40 id of each of the 20 classes (ScanNet's classes_SemVoxLabel-nyu40id.txt)."""
TSV = "scannetv2-labels.combined.tsv"
_RAW_IDS = 65536


def from_nyu40(ids: Integer[np.ndarray, "height width"]) -> UInt8[np.ndarray, "height width"]:
    """0..19, `IGNORE` for the other NYU40 classes and for 0 (unlabelled)."""
    return _nyu40_table()[np.clip(ids, 0, 255)]


def from_raw(
    ids: Integer[np.ndarray, "height width"], tsv: Path
) -> UInt8[np.ndarray, "height width"]:
    """0..19 or `IGNORE` from ScanNet's raw category ids, by the data set's own table."""
    return _raw_table(tsv)[np.clip(ids, 0, _RAW_IDS - 1)]


def find_tsv(folder: Path) -> Path:
    """ScanNet's table of categories beside a scene or up to three folders above."""
    for place in (folder, *folder.resolve().parents[:3]):
        if (place / TSV).is_file():
            return place / TSV
    raise InputError(
        f"{folder}: raw label ids need {TSV}, which comes with ScanNet's download "
        "(download-scannet.py --label_map); put it beside the scenes."
    )


@lru_cache(maxsize=1)
def _nyu40_table() -> np.ndarray:
    table = np.full(256, IGNORE, np.uint8)
    table[list(NYU40_IDS)] = np.arange(len(NYU40_IDS))
    return table


@lru_cache(maxsize=4)
def _raw_table(tsv: Path) -> np.ndarray:
    table = np.full(_RAW_IDS, IGNORE, np.uint8)
    try:
        with tsv.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file, delimiter="\t"):
                raw, nyu40 = int(row["id"]), int(row["nyu40id"])
                if not (0 <= raw < _RAW_IDS and 0 <= nyu40 <= 40):
                    raise ValueError(f"id {raw} or nyu40id {nyu40} is out of range")
                table[raw] = _nyu40_table()[nyu40]
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise InputError(
            f"{tsv}: expected tab-separated columns id and nyu40id ({error!r}); copy it again."
        ) from error
    return table
