from pathlib import Path

import numpy as np
import pytest

from mvsam.data.cache import cached_scene
from mvsam.data.readers.posed_folder import PosedFolder
from mvsam.errors import InputError
from tests.synthetic import write_posed_folder


def same_scene(cached, scene) -> None:
    assert cached.name == scene.name and len(cached) == len(scene)
    assert cached.views() == scene.views()
    for index in range(len(scene)):
        ours, truth = cached.frame(index), scene.frame(index)
        assert (ours.name, ours.size) == (truth.name, truth.size)
        np.testing.assert_array_equal(ours.intrinsics, truth.intrinsics)
        np.testing.assert_array_equal(ours.world_from_cam, truth.world_from_cam)
        np.testing.assert_array_equal(ours.image, truth.image)
        np.testing.assert_array_equal(ours.labels, truth.labels)
        if truth.depth is None:
            assert ours.depth is None
        else:
            np.testing.assert_allclose(ours.depth, truth.depth, atol=0.0005 + 1e-6)


@pytest.mark.parametrize(
    "options", [{}, {"views": True}, {"depth": False}, {"labels": False}], ids=str
)
def test_a_cached_scene_gives_what_the_scene_gave(tmp_path: Path, options: dict):
    write_posed_folder(tmp_path / "room", 3, (24, 16), **options)
    scene = PosedFolder(tmp_path / "room")
    first = cached_scene(scene, tmp_path / "cache")
    same_scene(first, scene)
    same_scene(cached_scene(scene, tmp_path / "cache"), scene)
    assert [path.suffix for path in (tmp_path / "cache").iterdir()] == [".npz"]


def test_the_second_reading_does_not_ask_the_scene_for_pictures(tmp_path: Path):
    write_posed_folder(tmp_path / "room", 2, (24, 16))
    scene = PosedFolder(tmp_path / "room")
    expected = cached_scene(scene, tmp_path / "cache").frame(1).image

    class Silent:
        name = scene.name

        def __len__(self) -> int:
            raise AssertionError("read again")

        frame = views = __len__

    actual = cached_scene(Silent(), tmp_path / "cache").frame(1).image  # pyright: ignore
    np.testing.assert_array_equal(actual, expected)


def test_depth_is_kept_to_the_millimetre(tmp_path: Path):
    write_posed_folder(tmp_path / "room", 2, (24, 16))
    depth = cached_scene(PosedFolder(tmp_path / "room"), tmp_path / "cache").frame(0).depth
    assert depth is not None and depth.dtype == np.float32
    np.testing.assert_allclose(1000 * depth, np.rint(1000 * depth), atol=1e-3)


@pytest.mark.parametrize("length", [0, 40, 3000, -30])
def test_a_cache_that_is_cut_short_is_named(tmp_path: Path, length: int):
    write_posed_folder(tmp_path / "room", 2, (24, 16))
    scene = PosedFolder(tmp_path / "room")
    cached_scene(scene, tmp_path / "cache")
    (file,) = (tmp_path / "cache").iterdir()
    file.write_bytes(file.read_bytes()[:length])
    with pytest.raises(InputError, match=r"room\.npz: about cannot be read .* it is made anew"):
        cached_scene(scene, tmp_path / "cache")


def test_a_cached_picture_of_damaged_size_is_named_before_memory_is_taken(tmp_path: Path):
    write_posed_folder(tmp_path / "room", 2, (24, 16))
    scene = PosedFolder(tmp_path / "room")
    cached_scene(scene, tmp_path / "cache")
    (file,) = (tmp_path / "cache").iterdir()
    content, true = file.read_bytes(), b"(16, 24, 3), }           "
    assert true in content
    file.write_bytes(content.replace(true, b"(99999999999, 24, 3), }  "))
    frame = cached_scene(scene, tmp_path / "cache").frame(0)
    with pytest.raises(InputError, match=r"image0 cannot be read \(Bad CRC-32"):
        _ = frame.image
