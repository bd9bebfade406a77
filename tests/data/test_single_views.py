"""Labelled photos without poses, as NYUv2's training images."""

from pathlib import Path

import numpy as np
import pytest

from mvsam.data.single_views import NAME_LISTS, SingleViews, read_names
from mvsam.errors import InputError
from tests.synthetic import depth_of, labels_of, write_posed_folder


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four photos; the poses are not read."""
    write_posed_folder(tmp_path, 4, (32, 24))
    for pose in (tmp_path / "poses").iterdir():
        pose.unlink()
    return tmp_path


def test_frames_hold_photo_depth_labels_and_the_camera(folder: Path):
    frame = SingleViews(folder)[1]
    assert frame.name == "0001" and frame.image.shape == (24, 32, 3)
    assert depth_of(frame).shape == labels_of(frame).shape == (24, 32)
    np.testing.assert_allclose(frame.intrinsics[:2, 2], (16.3, 11.8), atol=1e-6)


def test_names_are_left_out_or_are_the_only_ones(folder: Path):
    assert [f.name for f in SingleViews(folder, without=["0000", "0003"])] == ["0001", "0002"]
    assert [f.name for f in SingleViews(folder, only=["0003", "9999"])] == ["0003"]
    with pytest.raises(InputError, match="every photo is left out"):
        SingleViews(folder, only=[])


def test_a_folder_that_is_not_whole_is_refused(folder: Path, tmp_path: Path):
    with pytest.raises(InputError, match="holds no labelled photos"):
        SingleViews(tmp_path / "color")
    (folder / "depth" / "0002.png").unlink()
    with pytest.raises(InputError, match=r"0002\.png: the depth map is missing"):
        SingleViews(folder)


def test_lists_of_names_are_read_from_the_package_and_from_files(tmp_path: Path):
    (tmp_path / "names.txt").write_text("a b  # two\n\n# none\nc\n")
    assert read_names(str(tmp_path / "names.txt")) == ["a", "b", "c"]
    with pytest.raises(InputError, match="cannot be read as a list of names"):
        read_names("nyuv2_helld_out")


def test_a_tenth_of_nyuv2_is_kept_for_scores():
    held_out, posed = (read_names(name) for name in NAME_LISTS)
    assert len(set(held_out)) == 83 and len(set(posed)) == 59 + 32
    assert all(1 <= int(name) <= 1449 and len(name) == 4 for name in held_out + posed)
