"""What every reader's scene is checked for."""

from dataclasses import replace

import numpy as np
import pytest

from mvsam.data.readers.listed import ListedScene, file_inside
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


@pytest.mark.parametrize("path", [".", "./.", "a/..", "/", "..", "a/../..", "/etc/passwd", "", 3])
def test_a_path_that_names_no_file_of_the_folder_is_refused(tmp_path, path):
    with pytest.raises(InputError, match=r"^room: "):
        file_inside(tmp_path, path, "room")


def test_a_link_may_lead_out_of_the_folder(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk/a.png").touch()
    (tmp_path / "room").mkdir()
    (tmp_path / "room/images").symlink_to(tmp_path / "disk")
    assert file_inside(tmp_path / "room", "images/a.png", "room").is_file()
