"""What every reader's scene is checked for."""

from dataclasses import replace

import numpy as np
import pytest

from mvsam.data.readers.listed import ListedScene
from mvsam.errors import InputError
from mvsam.types import Frame

FRAME = Frame("a", (64, 48), np.diag([50.0, 50, 1]), np.eye(4), lambda: np.zeros((48, 64, 3)))


def test_photos_of_two_sizes_cannot_share_intrinsics():
    larger = replace(FRAME, name="b", size=(128, 96))
    with pytest.raises(InputError, match=r"a \(64x48\) and b \(128x96\) differ in size"):
        ListedScene("room", [FRAME, larger])
    own = replace(larger, intrinsics=np.diag([100.0, 100, 1]))
    assert len(ListedScene("room", [FRAME, own])) == 2


def test_none_and_two_of_one_name_are_refused():
    with pytest.raises(InputError, match="no frame"):
        ListedScene("room", [])
    with pytest.raises(InputError, match="two frames are called a"):
        ListedScene("room", [FRAME, FRAME])
