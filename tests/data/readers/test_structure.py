"""Photos and videos without poses: COLMAP finds some, or the sentence says why not."""

import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mvsam import weights
from mvsam.data.catalog import open_data
from mvsam.data.formats import open_scene
from mvsam.data.readers import structure
from mvsam.data.readers.video import extract_frames, thinned_frames
from mvsam.errors import InputError
from tests.synthetic import synthetic_views

SAMPLE = weights.ASSETS / "sample"


def write_video(path: Path, pictures: list[np.ndarray], rate: int = 30) -> None:
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=rate)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.bit_rate = 20_000_000
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())


def test_colmap_finds_the_poses_of_photos_up_to_scale(tmp_path, caplog):
    pytest.importorskip("pycolmap")
    shutil.copytree(SAMPLE / "color", tmp_path / "photos")
    (scene,) = open_data(str(tmp_path / "photos"), poses="colmap")
    assert len(scene) == 5
    assert "scale is unknown" in caplog.text and "--scale" in caplog.text
    truth = open_scene(SAMPLE)
    steps = [
        [np.linalg.norm(s.frame(i).world_from_cam[:3, 3] - s.frame(0).world_from_cam[:3, 3])
         for i in range(1, 5)]
        for s in (scene, truth)
    ]  # fmt: skip
    ratios = np.divide(steps[0], steps[1])
    assert ratios.max() / ratios.min() < 1.5, "five small photos; the shape is right, not exact"
    caplog.clear()
    assert len(open_scene(tmp_path / "photos", poses="colmap")) == 5
    assert "has a COLMAP model already" in caplog.text and "newer" not in caplog.text
    os.utime(tmp_path / "photos/0003.png", (time.time() + 60, time.time() + 60))
    assert len(open_scene(tmp_path / "photos", scale=0.3, poses="colmap")) == 5
    assert "0003.png is newer than its COLMAP model" in caplog.text
    assert caplog.text.count("scale is unknown") == 1


def test_a_bad_first_pair_of_few_photos_gets_another_chance(tmp_path, monkeypatch):
    pytest.importorskip("pycolmap")
    drawn, largest = [], structure._largest_model

    def unlucky_at_first(pycolmap, photos, files, work, seed):
        drawn.append(seed)
        size, model = largest(pycolmap, photos, files, work, seed)
        return (2 if seed == 0 else size), model

    monkeypatch.setattr(structure, "_largest_model", unlucky_at_first)
    shutil.copytree(SAMPLE / "color", tmp_path / "photos")
    assert len(open_scene(tmp_path / "photos", poses="colmap")) == 5
    assert drawn[:2] == [0, 1] and len(drawn) < structure.TRIES


def test_photos_without_poses_are_told_of_the_way_to_find_some(tmp_path):
    shutil.copytree(SAMPLE / "color", tmp_path / "photos")
    with pytest.raises(InputError, match="let --poses colmap find the poses"):
        open_scene(tmp_path / "photos")
    (tmp_path / "walk.mp4").write_bytes(b"")
    with pytest.raises(InputError, match="let --poses colmap find the poses"):
        open_scene(tmp_path / "walk.mp4")


@pytest.mark.parametrize(
    "count, message", [(0, "neither photos nor a video"), (2, "2 photos, too few for COLMAP")]
)
def test_too_few_photos_are_refused(tmp_path, count, message):
    for index in range(count):
        Image.new("RGB", (64, 48)).save(tmp_path / f"{index}.png")
    with pytest.raises(InputError, match=message):
        open_scene(tmp_path, poses="colmap")


def test_photos_that_share_nothing_are_refused_and_leave_no_model(tmp_path):
    pytest.importorskip("pycolmap")
    for index in range(3):
        Image.new("RGB", (64, 48), (40 * index, 0, 0)).save(tmp_path / f"{index}.png")
    with pytest.raises(InputError, match="COLMAP finds no poses"):
        open_scene(tmp_path, poses="colmap")
    assert not (tmp_path / "sparse").exists()


def test_a_video_is_thinned_to_two_pictures_a_second(tmp_path):
    pictures = [np.full((48, 64, 3), 5 * index, np.uint8) for index in range(40)]
    write_video(tmp_path / "walk.mp4", pictures, rate=20)
    files = thinned_frames(tmp_path / "walk.mp4", tmp_path / "frames")
    assert list(files) == [0, 10, 20, 30]
    values = [np.asarray(Image.open(file)).mean() for file in files.values()]
    np.testing.assert_allclose(values, [0, 50, 100, 150], atol=4)


def test_frames_that_are_there_are_not_decoded_again(tmp_path):
    pictures = [view.image for view in synthetic_views(4)]
    write_video(tmp_path / "walk.mp4", pictures)
    first = extract_frames(tmp_path / "walk.mp4", tmp_path / "f", lambda n: n in (1, 3))
    assert list(first) == [1, 3]
    first[1].write_bytes(b"mine")
    again = extract_frames(tmp_path / "walk.mp4", tmp_path / "f", lambda n: n in (1, 3), end=2)
    assert list(again) == [1] and first[1].read_bytes() == b"mine"


@pytest.mark.parametrize("content", [b"", b"no video", b"\0" * 2000])
def test_what_is_no_video_says_so(tmp_path, content):
    pytest.importorskip("av")
    (tmp_path / "walk.mp4").write_bytes(content)
    with pytest.raises(InputError, match="cannot be read as a video"):
        open_scene(tmp_path / "walk.mp4", poses="colmap")


def test_the_photos_of_a_posed_folder_are_found(tmp_path):
    assert structure.photo_folder(SAMPLE) == SAMPLE / "color"
    assert structure.photo_folder(tmp_path) is None
