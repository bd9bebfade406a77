"""TUM RGB-D, 7-Scenes and Replica folders, written here to their published layouts."""

import json

import numpy as np
import pytest
from PIL import Image

from mvsam.data.formats import open_scene
from mvsam.data.readers import seven_scenes
from mvsam.data.readers.register import register_depth
from mvsam.errors import InputError
from mvsam.geometry.pose import pose_from_quaternion, pose_from_rotation_vector
from tests.synthetic import depth_of, write_posed_folder


def save_depth(path, depth, units):
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.rint(depth * units).astype(np.uint16)).save(path)


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """(x, y, z, w) of a rotation with w > 0."""
    w = np.sqrt(1 + np.trace(rotation)) / 2
    r = rotation
    return np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 4 * w * w]) / (4 * w)


def write_tum(path, gap=0.004):
    truth = write_posed_folder(path / "source", extension="png")
    rgb, depth, poses = ["# color images"], ["# depth"], ["# timestamp tx ty tz qx qy qz qw"]
    for index, view in enumerate(truth):
        time = 1305031102.1 + index / 30
        (path / "rgb").mkdir(exist_ok=True)
        Image.fromarray(view.image).save(path / f"rgb/{time:.6f}.png")
        save_depth(path / f"depth/{time + gap:.6f}.png", view.depth, 5000)
        rgb.append(f"{time:.6f} rgb/{time:.6f}.png")
        depth.append(f"{time + gap:.6f} depth/{time + gap:.6f}.png")
        pose = [*view.world_from_cam[:3, 3], *quaternion_of(view.world_from_cam[:3, :3])]
        poses.append(f"{time - gap:.6f} " + " ".join(f"{value:.9f}" for value in pose))
    rgb.append("1305031199.0 rgb/without_a_pose.png")
    (path / "rgb.txt").write_text("\n".join(rgb))
    (path / "depth.txt").write_text("\n".join(depth))
    (path / "groundtruth.txt").write_text("\n".join(poses))
    matrix = truth[0].intrinsics - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
    np.savetxt(path / "intrinsics.txt", matrix)
    return truth


def test_tum_lists_are_joined_by_time(tmp_path, caplog):
    truth = write_tum(tmp_path)
    scene = open_scene(tmp_path)
    assert len(scene) == len(truth)
    assert "1 of 4 frames have no pose" in caplog.text
    for index, view in enumerate(truth):
        frame = scene.frame(index)
        np.testing.assert_allclose(frame.world_from_cam, view.world_from_cam, atol=1e-7)
        np.testing.assert_allclose(frame.intrinsics, view.intrinsics)
        np.testing.assert_array_equal(frame.image, view.image)
        np.testing.assert_allclose(depth_of(frame), view.depth, atol=0.11e-3)


def test_tum_cameras_follow_the_name_of_the_folder(tmp_path):
    folder = tmp_path / "rgbd_dataset_freiburg1_desk"
    folder.mkdir()
    truth = write_tum(folder)
    (folder / "intrinsics.txt").unlink()
    with pytest.raises(InputError, match="is 64x48"):  # its camera has 640x480 pixels
        open_scene(folder)
    for view, file in zip(truth, sorted((folder / "rgb").iterdir()), strict=True):
        Image.fromarray(view.image).resize((640, 480)).save(file)
    for file in (folder / "depth").iterdir():
        Image.fromarray(np.full((480, 640), 10000, np.uint16)).save(file)
    frame = open_scene(folder).frame(0)
    np.testing.assert_allclose(frame.intrinsics[0], [517.3, 0, 319.1])
    assert depth_of(frame)[240, 320] == 2.0


def test_other_cameras_than_the_benchmark_s_need_intrinsics(tmp_path):
    write_tum(tmp_path)
    (tmp_path / "intrinsics.txt").unlink()
    with pytest.raises(InputError, match=r"64x48, which none .* to .*/intrinsics\.txt"):
        open_scene(tmp_path)


@pytest.mark.parametrize(
    "file, text, message",
    [
        ("rgb.txt", "soon rgb/1.png", "time stamp"),
        ("rgb.txt", "1305031102.1 ../../1.png", "leaves the folder"),
        ("groundtruth.txt", "1305031102.1 0 0 0", "qx qy qz qw"),
        ("groundtruth.txt", "1305031102.1 0 0 0 0 0 0 0", "no rotation"),
        ("groundtruth.txt", "1 0 0 0 0 0 0 1", "none of its 4 pictures has a pose"),
        ("groundtruth.txt", "1305031102.1 nan 0 0 0 0 0 1", "not finite"),
        ("groundtruth.txt", "nan 0 0 0 0 0 0 1", "line 1: .*time stamp nan is not finite"),
        ("rgb.txt", "inf rgb/1.png", "line 1: .*time stamp inf is not finite"),
        ("depth.txt", "nan depth/1.png", "line 1: .*time stamp nan is not finite"),
        ("rgb.txt", "1305031102.1 " + "x" * 300, "cannot be read"),
        ("rgb.txt", "1305031102.1 .", "name a file in it"),
        ("intrinsics.txt", "50 0 32\n0 50 24\n7 8 9", "not of the form"),
    ],
)
def test_broken_tum_lists_say_what_to_do(tmp_path, file, text, message):
    write_tum(tmp_path)
    (tmp_path / file).write_text(text)
    with pytest.raises(InputError, match=message):
        open_scene(tmp_path)


def test_quaternions_and_rotation_vectors_agree_with_a_quarter_turn():
    root = np.sqrt(0.5)
    quarter = pose_from_quaternion(np.zeros(3), np.array([0, 0, 2 * root, 2 * root]))
    np.testing.assert_allclose(quarter[:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    other = pose_from_rotation_vector(np.array([0, 0, np.pi / 2]), np.array([1.0, 2, 3]))
    np.testing.assert_allclose(other[:3, :3], quarter[:3, :3], atol=1e-12)
    np.testing.assert_array_equal(other[:3, 3], [1, 2, 3])
    np.testing.assert_allclose(pose_from_rotation_vector(np.zeros(3), np.zeros(3)), np.eye(4))


def test_registered_depth_lies_where_the_colour_camera_sees_it():
    """A plane at 2 m: 10 cm beside, another focal length, nothing else."""
    depth = np.full((60, 80), 2.0)
    narrow = np.array([[80.0, 0, 40], [0, 80, 30], [0, 0, 1]])
    wide = np.array([[40.0, 0, 40], [0, 40, 30], [0, 0, 1]])
    beside = np.eye(4)
    beside[0, 3] = 0.1
    seen = register_depth(depth, narrow, wide, beside, (80, 60))
    rows, columns = np.nonzero(seen)
    # The plane spans x = -1..1 m there, so columns 40 + 40 (x + 0.1) / 2.
    assert (columns.min(), columns.max()) == (22, 61) and (rows.min(), rows.max()) == (15, 44)
    np.testing.assert_allclose(seen[15:45, 22:62], 2.0)


def test_the_nearest_surface_wins():
    depth = np.array([[1.0, 3.0]])
    shrink = np.array([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    wide = np.array([[0.1, 0, 0.5], [0, 0.1, 0.5], [0, 0, 1]])
    assert register_depth(depth, shrink, wide, np.eye(4), (1, 1)).item() == 1.0


def test_seven_scenes_registers_depth_and_moves_the_pose(tmp_path):
    pose = np.eye(4)
    pose[:3, 3] = 1, 2, 3
    for index, matrix in enumerate((pose, np.full((4, 4), np.nan))):
        stem = tmp_path / f"frame-{index:06d}"
        Image.new("RGB", (640, 480)).save(f"{stem}.color.png")
        depth = np.full((480, 640), 2000, np.uint16)
        depth[:200] = 65535
        Image.fromarray(depth).save(f"{stem}.depth.png")
        np.savetxt(f"{stem}.pose.txt", matrix)
    scene = open_scene(tmp_path)
    assert len(scene) == 1, "a frame whose tracking was lost is left out"
    frame = scene.frame(0)
    recovered = frame.world_from_cam @ seven_scenes.COLOR_FROM_DEPTH
    np.testing.assert_allclose(recovered, pose, atol=1e-12)
    values = depth_of(frame)
    known = values[values > 0]
    assert values[:180].max() == 0 and known.min() > 1.97 and known.max() < 2.03


def write_replica(path):
    truth = write_posed_folder(path / "source", extension="png")
    lines = []
    for index, view in enumerate(truth):
        (path / "results").mkdir(exist_ok=True)
        Image.fromarray(view.image).save(
            path / f"results/frame{index:06d}.jpg", quality=98, subsampling=0
        )
        save_depth(path / f"results/depth{index:06d}.png", view.depth, 6553.5)
        lines.append(" ".join(f"{value:.9f}" for value in view.world_from_cam.ravel()))
    (path / "traj.txt").write_text("\n".join(lines))
    k = truth[0].intrinsics
    camera = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2] - 0.5, "cy": k[1, 2] - 0.5}
    (path / "cam_params.json").write_text(json.dumps({"camera": camera | {"scale": 6553.5}}))
    return truth


def test_replica_comes_back(tmp_path):
    truth = write_replica(tmp_path)
    scene = open_scene(tmp_path)
    for index, view in enumerate(truth):
        frame = scene.frame(index)
        np.testing.assert_allclose(frame.world_from_cam, view.world_from_cam, atol=1e-8)
        np.testing.assert_allclose(frame.intrinsics, view.intrinsics)
        np.testing.assert_allclose(depth_of(frame), view.depth, atol=0.08e-3)
        error = (frame.image.astype(float) - view.image) ** 2
        assert 10 * np.log10(255**2 / error.mean()) > 38


def replica_camera(fx: str = "600", scale: str = "1000") -> str:
    return f'{{"camera": {{"fx": {fx}, "fy": 600, "cx": 32, "cy": 24, "scale": {scale}}}}}'


@pytest.mark.parametrize(
    "file, text, message",
    [
        ("traj.txt", "1 2 3", "16 numbers"),
        ("traj.txt", " ".join(["1"] * 16), "3 photos but 1 pose in"),
        ("traj.txt", "a b", "cannot be read"),
        ("cam_params.json", "{}", "expected an object"),
        ("cam_params.json", "[" * 100_000, "expected an object"),
        ("cam_params.json", replica_camera(fx="1" + "0" * 400), "expected an object"),
        ("cam_params.json", replica_camera(scale="1e999"), "the depth scale is inf"),
        ("cam_params.json", replica_camera(scale="0"), "the depth scale is 0"),
    ],
)
def test_broken_replica_folders_say_what_to_do(tmp_path, file, text, message):
    write_replica(tmp_path)
    (tmp_path / file).write_text(text)
    with pytest.raises(InputError, match=message):
        open_scene(tmp_path)
