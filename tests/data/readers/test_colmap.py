"""COLMAP models, written here with pycolmap itself or as its text format documents."""

import struct

import numpy as np
import pytest
from PIL import Image

from mvsam.data.formats import open_scene
from mvsam.data.readers import colmap_binary
from mvsam.errors import InputError
from tests.synthetic import write_posed_folder

pycolmap = pytest.importorskip("pycolmap")


def write_colmap(path, model="PINHOLE", extra=(), folder="sparse/0"):
    """Text files as COLMAP's documentation shows them; pixel centres at halves."""
    truth = write_posed_folder(path / "source", extension="png")
    (path / "images").mkdir()
    (path / folder).mkdir(parents=True)
    k = truth[0].intrinsics
    if model == "PINHOLE":
        params = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
    else:
        params = [k[0, 0], k[0, 2], k[1, 2], *extra]
    numbers = " ".join(repr(float(value)) for value in params)
    (path / folder / "cameras.txt").write_text(f"# cameras\n1 {model} 64 48 {numbers}\n")
    lines = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"]
    for index, view in enumerate(truth, start=1):
        pose = pycolmap.Rigid3d(np.linalg.inv(view.world_from_cam)[:3])
        x, y, z, w = pose.rotation.quat
        numbers = " ".join(repr(float(value)) for value in (w, x, y, z, *pose.translation))
        lines += [f"{index} {numbers} 1 {view.name}.png", ""]
        Image.fromarray(view.image).save(path / f"images/{view.name}.png")
    (path / folder / "images.txt").write_text("\n".join(lines) + "\n")
    (path / folder / "points3D.txt").write_text("# none\n")
    return truth


@pytest.mark.parametrize("form", ["text", "binary", "bare"])
def test_a_pinhole_model_comes_back(tmp_path, form, caplog):
    truth = write_colmap(tmp_path)
    if form == "binary":
        pycolmap.Reconstruction(str(tmp_path / "sparse/0")).write_binary(str(tmp_path / "sparse/0"))
        for file in (tmp_path / "sparse/0").glob("*.txt"):
            file.unlink()
    scene = open_scene(tmp_path / "sparse/0" if form == "bare" else tmp_path)
    assert len(scene) == len(truth)
    assert "--scale" in caplog.text
    for index, view in enumerate(truth):
        frame = scene.frame(index)
        assert frame.name == view.name
        np.testing.assert_allclose(frame.world_from_cam, view.world_from_cam, atol=1e-9)
        np.testing.assert_allclose(frame.intrinsics, view.intrinsics)
        np.testing.assert_array_equal(frame.image, view.image)


def test_its_points_come_in_the_unit_of_the_poses(tmp_path):
    write_colmap(tmp_path)
    (tmp_path / "sparse/0/points3D.txt").write_text("1 0.5 1 -2 90 90 90 0.7\n7 0 0 3 0 0 0 0.1\n")
    for scale in (1.0, 2.0):
        points = np.array(sorted(open_scene(tmp_path, scale=scale).points.tolist()))  # pyright: ignore
        np.testing.assert_allclose(points, scale * np.array([[0, 0, 3], [0.5, 1, -2]]))


def test_a_lens_is_taken_away_as_our_own_formula_does(tmp_path):
    from mvsam.data.readers.undistort import Distortion, undistort

    truth = write_colmap(tmp_path, "RADIAL", (-0.2, 0.05))
    frame = open_scene(tmp_path).frame(0)
    expected = undistort(truth[0].image, frame.intrinsics, Distortion("brown", (-0.2, 0.05)))
    np.testing.assert_array_equal(frame.image, expected)


LENSES = {
    "SIMPLE_RADIAL": (-0.2,),
    "RADIAL": (-0.2, 0.03),
    "OPENCV": (-0.2, 0.03, 0.004, -0.003),
    "FULL_OPENCV": (-0.2, 0.03, 0.004, -0.003, 0.01, 0.02, -0.01, 0.005),
    "OPENCV_FISHEYE": (0.05, -0.02, 0.01, -0.004),
    "SIMPLE_RADIAL_FISHEYE": (0.05,),
    "RADIAL_FISHEYE": (0.05, -0.02),
    "THIN_PRISM_FISHEYE": (0.05, -0.02, 0.004, -0.003, 0.01, -0.004, 0.002, -0.003),
    "FOV": (0.9,),
    "SIMPLE_FISHEYE": (),
    "FISHEYE": (),
    "RAD_TAN_THIN_PRISM_FISHEYE": (0.05, -0.02, 0.01, 0, 0, 0, 0.004, -0.003, 0.01, 0, 0.01, 0),
    "SIMPLE_DIVISION": (-0.2,),
    "DIVISION": (-0.2,),
    "EUCM": (0.6, 1.1),
}
"""Distortion parameters of every camera model that is neither pinhole nor panorama."""


@pytest.mark.parametrize("model", LENSES)
def test_a_straight_camera_sees_what_any_lens_has_seen(tmp_path, model):
    """The picture holds, at each pixel, the direction that COLMAP says the pixel looks in."""
    truth = write_colmap(tmp_path)
    k = truth[0].intrinsics
    some = pycolmap.Camera.create_from_model_name(1, model, 50.0, 64, 48)
    focal = [k[0, 0], k[1, 1]][: len(some.focal_length_idxs())]
    params = [*focal, k[0, 2], k[1, 2], *LENSES[model]]
    numbers = " ".join(repr(float(value)) for value in params)
    (tmp_path / "sparse/0/cameras.txt").write_text(f"1 {model} 64 48 {numbers}\n")
    lens = pycolmap.Camera(model=model, width=64, height=48, params=params)
    rows, columns = np.mgrid[:48, :64] + 0.5
    rays = lens.cam_from_img(np.stack([columns, rows], axis=-1).reshape(-1, 2)).reshape(48, 64, 2)
    colours = np.concatenate([160 * rays, np.zeros((48, 64, 1))], axis=-1) + 128
    Image.fromarray(colours.round().clip(0, 255).astype(np.uint8)).save(
        tmp_path / "images/0000.png"
    )
    frame = open_scene(tmp_path).frame(0)
    k = frame.intrinsics
    straight = (columns - k[0, 2]) / k[0, 0], (rows - k[1, 2]) / k[1, 1]
    inside = np.s_[4:44, 6:58]
    for channel, expected in enumerate(straight):
        seen = (frame.image[..., channel].astype(float) - 128) / 160
        assert np.abs(seen - expected)[inside].max() < 0.008, "a level of colour is 0.006"
    assert np.abs(rays[..., 0] - straight[0])[inside].max() > 0.016, (
        "without a lens it would differ"
    )


def test_every_lens_of_colmap_is_tried():
    others = {"INVALID", "PINHOLE", "SIMPLE_PINHOLE", "EQUIRECTANGULAR"}
    assert set(LENSES) | others == set(pycolmap.CameraModelId.__members__)


def test_a_scale_moves_the_cameras_alone(tmp_path):
    truth = write_colmap(tmp_path)
    frame = open_scene(tmp_path, scale=2.5).frame(2)
    pose, given = frame.world_from_cam, truth[2].world_from_cam
    np.testing.assert_allclose(pose[:3, 3], 2.5 * given[:3, 3], atol=1e-12)
    np.testing.assert_allclose(pose[:3, :3], given[:3, :3], atol=1e-12)
    with pytest.raises(InputError, match="metres a unit"):
        open_scene(tmp_path, scale=-1.0)


def test_photos_that_are_not_there_or_of_another_size_are_named(tmp_path):
    write_colmap(tmp_path)
    Image.new("RGB", (32, 24)).save(tmp_path / "images/0001.png")
    with pytest.raises(InputError, match=r"0001\.png: is 32x24"):
        open_scene(tmp_path)
    (tmp_path / "images").rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="put the photos there"):
        open_scene(tmp_path)


@pytest.mark.parametrize("text", ["1 NO_SUCH_MODEL 64 48 1 2 3", "1 PINHOLE sixty 48"])
def test_a_model_that_colmap_cannot_read_is_refused(tmp_path, text):
    write_colmap(tmp_path)
    (tmp_path / "sparse/0/cameras.txt").write_text(text)
    with pytest.raises(InputError, match="cannot read this model"):
        open_scene(tmp_path)


def with_points(path, unit: float):
    """The model of `write_colmap` in another unit, with 80 points where the depth says they are."""
    truth = write_colmap(path)
    (path / "source/depth").rename(path / "depth")
    model = pycolmap.Reconstruction(str(path / "sparse/0"))
    view, image = truth[0], model.images[1]
    rows, columns = np.divmod(np.arange(80) * 37, 64)
    pixels = np.stack([columns + 0.5, rows + 0.5], axis=1)
    image.points2D = pycolmap.Point2DList([pycolmap.Point2D(xy) for xy in pixels])
    rays = np.column_stack([pixels, np.ones(80)]) @ np.linalg.inv(view.intrinsics).T
    points = rays * view.depth[rows, columns, None]
    world = points @ view.world_from_cam[:3, :3].T + view.world_from_cam[:3, 3]
    for index, xyz in enumerate(world):
        track = pycolmap.Track([pycolmap.TrackElement(1, index)])
        model.add_point3D(xyz, track)
    model.transform(pycolmap.Sim3d(1 / unit, pycolmap.Rotation3d(), np.zeros(3)))
    model.write(str(path / "sparse/0"))
    for file in (path / "sparse/0").glob("*.txt"):
        file.unlink()
    return truth


def test_measured_depth_tells_how_long_a_unit_is(tmp_path, caplog):
    truth = with_points(tmp_path, unit=0.25)
    scene = open_scene(tmp_path)
    assert "one unit of the model is 0.25 m" in caplog.text
    for index, view in enumerate(truth):
        frame = scene.frame(index)
        np.testing.assert_allclose(frame.world_from_cam, view.world_from_cam, atol=1e-3)
        assert frame.depth is not None
        np.testing.assert_allclose(frame.depth, view.depth, atol=0.51e-3)
    with pytest.raises(InputError, match="leave --scale out"):
        open_scene(tmp_path, scale=2.0)


def write_binary_model(path):
    """Files as pycolmap writes them, with one point seen once, and rigs and frames."""
    write_colmap(path)
    folder = path / "sparse/0"
    model = pycolmap.Reconstruction(str(folder))
    model.images[1].points2D = pycolmap.Point2DList([pycolmap.Point2D(np.array([3.5, 4.5]))])
    track = pycolmap.Track([pycolmap.TrackElement(1, 0)])
    model.add_point3D(np.array([0.1, 0.2, 2.0]), track)
    model.write_binary(str(folder))
    for file in folder.glob("*.txt"):
        file.unlink()
    return folder


COUNTS = {
    "cameras": [0],
    "images": [0, 8 + 64 + len("0000.png") + 1],
    "points3D": [0, 8 + 43],
    "rigs": [0, 8 + 4],
    "frames": [0, 8 + 64],
}
"""Where counts stand in the files of `write_binary_model`: of entries, and within the first."""


@pytest.mark.parametrize("name", COUNTS)
def test_a_count_beyond_the_end_of_a_binary_file_takes_no_memory(tmp_path, name):
    file = write_binary_model(tmp_path) / f"{name}.bin"
    content = file.read_bytes()
    for place in COUNTS[name]:
        for size in (4, 3):  # bytes that read as more than there is memory, or just enough
            broken = bytearray(content)
            broken[place : place + size] = b"\xff" * size
            file.write_bytes(broken)
            with pytest.raises(InputError, match=rf"{name}\.bin: COLMAP cannot read .* near byte"):
                open_scene(tmp_path)
    file.write_bytes(content)
    assert len(open_scene(tmp_path)) == 3


def test_every_cut_of_a_binary_file_is_refused(tmp_path):
    folder = write_binary_model(tmp_path)
    for name in COUNTS:
        content = (folder / f"{name}.bin").read_bytes()
        for length in range(0, len(content), 7):
            (folder / f"{name}.bin").write_bytes(content[:length])
            with pytest.raises(InputError, match=rf"{name}\.bin: COLMAP cannot read"):
                open_scene(tmp_path)
        (folder / f"{name}.bin").write_bytes(content)


def test_every_camera_model_of_colmap_has_its_length_here(tmp_path):
    write_colmap(tmp_path)
    for name, identifier in pycolmap.CameraModelId.__members__.items():
        if name != "INVALID":
            camera = pycolmap.Camera.create_from_model_id(1, identifier, 50.0, 64, 48)
            assert colmap_binary.PARAMETERS[int(identifier)] == len(camera.params)


def test_images_and_points_of_two_models_are_refused(tmp_path):
    folder = write_binary_model(tmp_path)
    (tmp_path / "source/depth").rename(tmp_path / "depth")
    (folder / "points3D.bin").write_bytes(bytes(8))
    with pytest.raises(InputError, match=r"0000\.png sees points that the COLMAP model lacks"):
        open_scene(tmp_path)


def test_a_pose_that_has_no_inverse_is_refused(tmp_path):
    frames = write_binary_model(tmp_path) / "frames.bin"
    content = bytearray(frames.read_bytes())
    content[16:48] = struct.pack("<4d", 0, 1.5e51, 0, 6.8e45)  # COLMAP takes it as normalised
    frames.write_bytes(content)
    with pytest.raises(InputError, match="the pose is not"):
        open_scene(tmp_path)


@pytest.mark.parametrize("form", ["text", "binary"])
def test_panoramas_are_refused(tmp_path, form):
    write_colmap(tmp_path)
    folder = tmp_path / "sparse/0"
    (folder / "cameras.txt").write_text("1 EQUIRECTANGULAR 64 48 64 48\n")
    if form == "binary":
        pycolmap.Reconstruction(str(folder)).write_binary(str(folder))
    with pytest.raises(InputError, match=r"0000\.png: COLMAP's EQUIRECTANGULAR pictures"):
        open_scene(tmp_path)


@pytest.mark.parametrize("name", ["!" * 300, "x" * 300, ".", "/", "x/..", "x/../../0000.png"])
def test_a_name_that_no_photo_can_have_is_refused(tmp_path, name):
    """Those before 0000.png, in the order of names, tell where the photos lie; others follow."""
    write_colmap(tmp_path)
    file = tmp_path / "sparse/0/images.txt"
    file.write_text(file.read_text().replace("0002.png", name))
    with pytest.raises(InputError):
        open_scene(tmp_path)
