"""ARKit scans beyond the round trip: the video itself, and what is broken."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from mvsam.data.formats import open_scene
from mvsam.errors import InputError
from mvsam.types import Frame
from tests.data.readers.layouts import write_arkitscenes, write_icl, write_ios_logger
from tests.data.readers.test_structure import write_video
from tests.synthetic import synthetic_views


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Eight views, 11 cm apart, of the size of the video divided by twelve."""
    return [
        Frame(
            v.name, (160, 120), v.intrinsics, v.world_from_cam,
            lambda v=v: v.image, lambda v=v: v.depth,
        )
        for v in synthetic_views(8, (160, 120))
    ]  # fmt: skip


def test_keyframes_of_the_video_are_decoded_when_there_are_no_pictures(tmp_path, frames, caplog):
    write_ios_logger(frames, tmp_path, folder="", every=2)
    pictures = [frames[n // 2].image for n in range(2 * len(frames))]
    write_video(tmp_path / "Frames.m4v", pictures, rate=60)
    scene = open_scene(tmp_path)
    assert "8 keyframes decoded" in caplog.text
    assert [scene.frame(i).name for i in range(len(scene))] == [f"{2 * n:06d}" for n in range(8)]
    for index, view in enumerate(frames):
        errors = [
            np.square(scene.frame(index).image - v.image.astype(float)).mean() for v in frames
        ]
        assert int(np.argmin(errors)) == index and errors[index] < 100, "colour at half the size"
        np.testing.assert_allclose(
            scene.frame(index).world_from_cam, view.world_from_cam, atol=1e-6
        )


def test_an_interrupted_decoding_goes_on(tmp_path, frames):
    write_ios_logger(frames, tmp_path, folder="")
    write_video(tmp_path / "Frames.m4v", [frame.image for frame in frames], rate=60)
    open_scene(tmp_path)
    (tmp_path / "frames/000003.jpg").unlink()
    assert len(open_scene(tmp_path)) == 8


def test_pictures_without_a_pose_in_time_count_as_lost(tmp_path, frames, caplog):
    write_ios_logger(frames, tmp_path)
    poses = (tmp_path / "ARposes.txt").read_text().splitlines()
    (tmp_path / "ARposes.txt").write_text("\n".join(poses[:5]))
    scene = open_scene(tmp_path)
    assert getattr(scene, "num_lost", 0) == 8 - len(scene) > 0
    assert "frames have no pose" in caplog.text


@pytest.mark.parametrize(
    "file, text, message",
    [
        ("Frames.txt", "1, 2, 3", "expected 'time, number, fx, fy, cx, cy'"),
        ("Frames.txt", "100, 1e99, 1, 1, 1, 1", "expected 'time, number"),
        ("Frames.txt", "7, 0, 1600, 1600, 960, 720", "no picture of Frames.txt has a pose"),
        ("Frames.txt", "", "no picture of Frames.txt has a pose"),
        ("ARposes.txt", "100, 0, 0, 0, 0, 0, 0, 0", "no rotation"),
        ("ARposes.txt", "100, 0, 0", "expected 'time, tx, ty, tz, qw"),
        ("ARposes.txt", "100, nan, 0, 0, 1, 0, 0, 0", "not finite"),
        ("ARposes.txt", "nan, 0, 0, 0, 1, 0, 0, 0", "line 1: .*time stamp nan is not finite"),
        ("Frames.txt", "nan, 0, 1600, 1600, 960, 720", "line 1: .*time stamp nan is not finite"),
    ],
)
def test_broken_recordings_say_what_to_do(tmp_path, frames, file, text, message):
    write_ios_logger(frames, tmp_path)
    (tmp_path / file).write_text(text)
    with pytest.raises(InputError, match=message):
        open_scene(tmp_path)


def test_a_recording_without_video_and_pictures_is_refused(tmp_path, frames):
    write_ios_logger(frames, tmp_path, folder="")
    with pytest.raises(InputError, match=r"neither Frames\.m4v nor a folder frames/"):
        open_scene(tmp_path)


def write_video_folder(tmp_path: Path, frames: list[Frame]) -> Path:
    write_arkitscenes(frames, tmp_path / "42")
    return tmp_path / "42"


def test_the_inner_folder_of_arkitscenes_opens_too(tmp_path, frames):
    path = write_video_folder(tmp_path, frames)
    assert len(open_scene(path / "42_frames")) == 8


def test_pictures_between_two_poses_are_left_out(tmp_path, frames, caplog):
    path = write_video_folder(tmp_path, frames)
    file = path / "42_frames/lowres_wide.traj"
    file.write_text("\n".join(file.read_text().splitlines()[::6]))
    assert len(open_scene(path)) == 2
    assert "6 of 8 frames have no pose" in caplog.text


@pytest.mark.parametrize(
    "name, text, message",
    [
        ("lowres_wide.traj", "4300 1 2", "expected 'time rx ry rz tx ty tz'"),
        ("lowres_wide.traj", "4300 nan 0 0 0 0 0", "expected 'time rx"),
        ("lowres_wide.traj", "4300 0 1e999 0 0 0 0", "one is not finite or too large"),
        ("lowres_wide_intrinsics/42_4300.000.pincam", "160 120", "expected 'width height"),
        ("lowres_wide_intrinsics/42_4300.000.pincam", "", "expected 'width height"),
        ("lowres_wide_intrinsics/42_4300.000.pincam", "256 192 1 1 9 9", "is for 256x192"),
        ("lowres_wide/42_soon.png", "", "does not end with a time"),
        ("lowres_wide/42_nan.png", "", "does not end with a time"),
        ("lowres_depth/42_4300.000.png", "no picture", "the depth map cannot be read"),
    ],
)
def test_broken_arkitscenes_say_what_to_do(tmp_path, frames, name, text, message):
    path = write_video_folder(tmp_path, frames)
    (path / "42_frames" / name).write_text(text)
    with pytest.raises(InputError, match=message):
        open_scene(path)


def test_arkitscenes_without_intrinsics_are_refused(tmp_path, frames):
    path = write_video_folder(tmp_path, frames)
    shutil.rmtree(path / "42_frames/lowres_wide_intrinsics")
    with pytest.raises(InputError, match="copy lowres_wide_intrinsics too"):
        open_scene(path)


def test_icl_nuim_pictures_have_one_size_and_one_trajectory(tmp_path, frames):
    write_icl(frames, tmp_path)
    with pytest.raises(InputError, match="ICL-NUIM has 640x480"):
        open_scene(tmp_path)
    (tmp_path / "other.gt.freiburg").write_text("")
    with pytest.raises(InputError, match="holds 2 trajectories"):
        open_scene(tmp_path)
