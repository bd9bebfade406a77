"""Labelled photographs without poses: `color/`, `depth/`, `labels/` and one `intrinsics.txt`.

They teach labels, prompted with the depth that a sensor measured; stereo needs poses.
"""

from collections.abc import Sequence
from functools import partial
from importlib.resources import files
from pathlib import Path

import numpy as np

from mvsam.data.checks import check_intrinsics
from mvsam.data.files import (
    check_map,
    check_photo,
    load_depth,
    load_labels,
    load_matrix,
    load_photo,
)
from mvsam.data.labels import SCANNET20
from mvsam.errors import InputError
from mvsam.types import Frame

NAME_LISTS = ("nyuv2_heldout", "nyuv2_posed")
"""Lists of photos that come with the package: a tenth of NYUv2's training images, which is kept for
scores, and those we know poses of."""


def read_names(name: str) -> list[str]:
    """The names in a list of the package or in a text file, apart by blanks; `#` starts a comment.

    InputError for a file that cannot be read.
    """
    packaged = files("mvsam") / "assets" / f"{name}.txt"
    source = packaged if name in NAME_LISTS else Path(name)
    try:
        lines = source.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(
            f"{name}: cannot be read as a list of names ({error}); name a text file or one of "
            f"{', '.join(NAME_LISTS)}."
        ) from error
    return [word for line in lines for word in line.partition("#")[0].split()]


class SingleViews(Sequence[Frame]):
    """Frames of a folder of labelled photographs, sorted by name, each in a world of its own.

    without: names that are left out; only: if given, all others are.
    Raises `InputError` for a folder that is not whole. Pictures' pixels are read when asked for.
    """

    def __init__(
        self, path: str | Path, without: Sequence[str] = (), only: Sequence[str] | None = None
    ):
        self.path = Path(path)
        if not (self.path / "labels").is_dir():
            raise InputError(
                f"{path}: holds no labelled photos; it needs color/, depth/, labels/ and "
                "intrinsics.txt."
            )
        wanted = {file.stem for file in (self.path / "labels").glob("*.png")} - {*without}
        names = sorted(wanted if only is None else wanted & {*only})
        if not names:
            raise InputError(f"{path}: every photo is left out; leave fewer out.")
        self._frames = [self._make_frame(name) for name in names]

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index):
        return self._frames[index]

    def _make_frame(self, name: str) -> Frame:
        photo = self.path / "color" / f"{name}.jpg"
        photo = photo if photo.exists() else photo.with_suffix(".png")
        depth, labels = (self.path / kind / f"{name}.png" for kind in ("depth", "labels"))
        size = check_photo(photo)
        check_map(depth, "depth", size)
        check_map(labels, "label", size)
        intrinsics = load_matrix(self.path / "intrinsics.txt", 3, 3, "intrinsics matrix")
        check_intrinsics(intrinsics, size, str(self.path / "intrinsics.txt"))
        # The file counts pixel centres at integers, as OpenCV calibrates; ours lie at halves.
        return Frame(
            name=name,
            size=size,
            intrinsics=intrinsics + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]),
            world_from_cam=np.eye(4),
            load_image=partial(load_photo, photo),
            load_depth=partial(load_depth, depth),
            load_labels=partial(load_labels, labels, len(SCANNET20)),
        )
