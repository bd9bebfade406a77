"""Lists of photos by name: which are kept for scores, which are left out of training."""

from importlib.resources import files
from pathlib import Path

from mvsam.errors import InputError

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
