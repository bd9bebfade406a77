"""The page of `mvsam report`: whole, self-contained, true to the folder, and safe with any name."""

import base64
import json
import shutil
import subprocess
from dataclasses import dataclass
from html.parser import HTMLParser
from importlib.resources import files
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mvsam.apps.report import page as page_module
from mvsam.apps.report.cloud_data import first_view, frusta, thinned
from mvsam.apps.report.page import build_page, count_steps
from mvsam.apps.report.photos import read_photos
from mvsam.apps.report.rows import photo_row
from mvsam.apps.report.thumbnails import (
    UNSURE_TO_SURE,
    confidence_colors,
    confidence_thumbnail,
    depth_thumbnail,
    label_thumbnail,
    photo_thumbnail,
)
from mvsam.commands.report import Report
from mvsam.commands.view import View
from mvsam.data.formats import open_scene
from mvsam.data.labels import SCANNET20
from mvsam.data.sampling import evenly_spaced
from mvsam.errors import InputError
from mvsam.inference.pictures import depth_picture
from mvsam.inference.scene import predict_scene
from mvsam.reconstruction.cloud import PointCloud, build_cloud
from mvsam.reconstruction.filtering import project
from mvsam.reconstruction.folder import read_predictions
from mvsam.reconstruction.settings import CloudSettings
from mvsam.types import IGNORE
from tests.inference.fake_model import FakeModel
from tests.synthetic import camera_intrinsics, camera_pose, write_posed_folder

SIZE = (64, 48)
WITHOUT_END = {"meta", "link", "img", "br", "input"}


class Page(HTMLParser):
    """All elements with their attributes, and every text with the tag that it stands in."""

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[tuple[str, str]] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in WITHOUT_END:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag, f"</{tag}> closes another element"

    def handle_data(self, data):
        if data.strip():
            self.texts.append((self.open[-1] if self.open else "", data.strip()))

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]

    def text_of(self, tag: str) -> list[str]:
        return [text for name, text in self.texts if name == tag]

    def alternatives(self) -> set[str]:
        """First words of the pictures' alternative texts."""
        return {str(picture["alt"]).split()[0] for picture in self.all("img")}

    def cloud(self) -> dict:
        (text,) = [text for text in self.text_of("script") if text.startswith("{")]
        return json.loads(text)


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    """Folders `both`, `depth` and `labels`: what models of both tasks and of one wrote."""
    path = tmp_path_factory.mktemp("report")
    write_posed_folder(path / "room", 4, SIZE)
    models = {
        "both": FakeModel(),
        "depth": FakeModel(has_labels=False),
        "labels": FakeModel(has_depth=False),
    }
    for name, model in models.items():
        predict_scene(model, open_scene(path / "room"), path / name)
    return path


@pytest.fixture
def folder(kept: Path, tmp_path: Path) -> Path:
    """One to damage: of both tasks."""
    return Path(shutil.copytree(kept / "both", tmp_path / "both"))


def page_of(folder: Path) -> str:
    return build_page(folder, read_photos(folder), CloudSettings())


def numbers(text: str, kind: str, columns: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind).reshape(-1, columns)


@pytest.mark.parametrize("tasks", ["both", "depth", "labels"])
def test_the_page_loads_nothing_from_anywhere(kept: Path, tasks: str):
    text = page_of(kept / tasks)
    for forbidden in ("http://", "https://", "url(", "@import", "import(", "fetch("):
        assert forbidden not in text
    for _, attributes in Page(text).elements:
        for name in ("src", "href"):
            assert (attributes.get(name) or "data:").startswith("data:")


@pytest.mark.parametrize("tasks", ["both", "depth", "labels"])
def test_every_element_is_closed_in_order_and_every_picture_is_described(kept: Path, tasks: str):
    page = Page(page_of(kept / tasks))
    assert page.open == []
    assert page.text_of("title") == ["room - mvsam report"]
    assert all(picture["alt"] and picture["loading"] == "lazy" for picture in page.all("img"))
    identifiers = [a["id"] for _, a in page.elements if "id" in a]
    assert len(identifiers) == len(set(identifiers))


def test_the_embedded_points_are_those_of_the_cloud(folder: Path):
    settings = CloudSettings()
    cloud = build_cloud(read_predictions(folder), settings)
    data = Page(page_of(folder)).cloud()
    extent = np.array(data["extent"])
    points = np.array(data["low"]) + extent * numbers(data["positions"], "<u2", 3) / 65535
    # Half a step of 16 bits over the box, and float32 of a few metres.
    assert np.all(np.abs(points - cloud.points) <= 0.5 * extent / 65535 + 1e-6)
    np.testing.assert_array_equal(numbers(data["colors"], "u1", 3), cloud.colors)
    np.testing.assert_array_equal(numbers(data["labels"], "u1", 1)[:, 0], cloud.labels)
    confidence = numbers(data["confidence"], "u1", 1)[:, 0] / 255
    np.testing.assert_allclose(confidence, cloud.confidence, atol=0.5 / 255 + 1e-6)
    assert data["voxelSize"] == settings.voxel_size
    np.testing.assert_array_equal(data["palette"][: len(SCANNET20)], SCANNET20.colors)
    assert len(numbers(data["frusta"], "<f4", 3)) == 4 * 16


def test_a_large_cloud_is_thinned_evenly():
    random = np.random.default_rng(0)
    corner = 0.3 * random.random((3000, 3))  # denser than the rest
    points = np.concatenate([corner, random.random((3000, 3))]).astype(np.float32) * [1, 1, 0]
    cloud = PointCloud(
        points.astype(np.float32),
        np.full((6000, 3), 100, np.uint8),
        np.full(6000, 4, np.uint8),
        np.full(6000, 0.5, np.float32),
    )
    few, voxel_size = thinned(cloud, 0.001, most=500)
    assert 100 < len(few) <= 500 and voxel_size > 0.01
    nearest = np.linalg.norm(cloud.points[:, None] - few.points[None], axis=-1).min(axis=1)
    assert nearest.max() < 1.5 * voxel_size  # every point has a kept one in its own voxel
    assert np.all(few.labels == 4) and np.all(few.colors == 100)
    assert thinned(few, voxel_size, most=500) == (few, voxel_size)


@dataclass
class Camera:
    world_from_cam: np.ndarray
    size: tuple[int, int] = SIZE

    @property
    def intrinsics(self) -> np.ndarray:
        return camera_intrinsics(self.size)


def turned(yaw_deg: float, pitch_deg: float = 0) -> Camera:
    """At the origin, its x to the right, y down; yaw to the right, then pitch downwards."""
    yaw, pitch = np.deg2rad([yaw_deg, -pitch_deg])
    pose = np.eye(4)
    about_y = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
    about_x = [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
    pose[:3, :3] = np.array(about_y) @ about_x
    return Camera(pose)


def eye_of(view: dict) -> np.ndarray:
    """As `Orbit` in orbit.js places it before the first turn."""
    up, front = np.array(view["up"]), np.array(view["front"])
    back = -np.cos(view["pitch"]) * front + np.sin(view["pitch"]) * up
    return view["target"] + view["distance"] * back


def test_the_first_view_is_from_behind_the_mean_camera_where_the_cameras_look():
    cameras = [Camera(camera_pose(index, yaw_deg=0)) for index in range(3)]
    center = np.mean([camera.world_from_cam[:3, 3] for camera in cameras], axis=0)
    points = center + np.array([[0.0, 0, 2], [1, 0, 2], [-1, 0, 2]])
    view = first_view(points, cameras)
    np.testing.assert_allclose(view["up"], [0, -1, 0], atol=1e-9)
    np.testing.assert_allclose(view["front"], [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(view["target"], center + np.array([0, 0, 2]), atol=1e-9)
    np.testing.assert_allclose(eye_of(view), center - [0, 0, 0.5], atol=1e-9)


def test_cameras_that_look_down_give_a_first_view_that_looks_down():
    camera = turned(yaw_deg=40, pitch_deg=30)
    look = camera.world_from_cam[:3, 2]
    assert look[1] > 0.4  # y points down
    view = first_view(2 * look[None], [camera])
    # One camera's own up is the best there is, so its view is level.
    assert view["pitch"] == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(eye_of(view), -0.5 * look, atol=1e-9)
    around = [turned(yaw, 30) for yaw in (-60, -20, 20, 60)]
    view = first_view(np.array([[0, 1.0, 2]]), around)
    assert view["up"][1] < -0.9 and view["pitch"] > 0.2
    assert np.dot(view["up"], view["front"]) == pytest.approx(0, abs=1e-9)


def test_cameras_that_look_to_all_sides_give_a_view_of_the_whole_cloud():
    points = np.random.default_rng(0).uniform(-2, 2, (100, 3))
    view = first_view(points, [turned(yaw) for yaw in (0, 90, 180, 270)])
    np.testing.assert_allclose(view["target"], np.median(points, axis=0))
    assert np.linalg.norm(points - eye_of(view), axis=1).min() > 0.5
    assert eye_of(view)[1] < -2  # from above


def test_a_frustum_ends_at_the_corners_of_its_photo():
    camera = turned(25, 10)
    (lines,) = frusta([camera], 0.3)
    corners, depth = project(camera, lines[1:8:2])
    np.testing.assert_allclose(corners, [[0, 0], [64, 0], [64, 48], [0, 48]], atol=1e-9)
    np.testing.assert_allclose(depth, 0.3)
    np.testing.assert_allclose(lines[0:8:2], 0, atol=1e-12)  # where the camera is


def test_the_legend_has_the_shares_of_labelled_pixels_the_largest_first(folder: Path):
    labels = np.full((48, 64), 3, np.uint8)
    labels[:12] = IGNORE
    labels[12:21] = 7
    for path in (folder / "labels").iterdir():
        Image.fromarray(labels).save(path)
    text = page_of(folder)
    rows = text[text.index("<tbody>") : text.index("</tbody>")].strip().splitlines()[1:]
    assert [Page(row).text_of("button") for row in rows] == [["bed"], ["door"]]
    shares = [Page(row).text_of("td")[0] for row in rows]
    assert shares == ["75.0", "25.0"]
    assert f"rgb{SCANNET20.colors[3]}" in rows[0]
    assert [a.get("data-label") for a in Page(text).all("button") if "data-label" in a] == [
        "3",
        "7",
    ]


def test_every_name_from_a_file_is_escaped(folder: Path):
    evil = "<script>alert('&\"')</script>"
    (folder / "color" / "0001.jpg").rename(folder / "color" / '<b>"1".jpg')
    index = (folder / "transforms.json").read_text()
    (folder / "transforms.json").write_text(index.replace("color/0001", r"color/<b>\"1\""))
    classes = [{"name": f"{evil}{k}", "color": [k, 0, 0]} for k in range(20)]
    (folder / "classes.json").write_text(json.dumps(classes))
    run = json.loads((folder / "run.json").read_text())
    for key in ("scene", "model", "weights_hash", "device"):
        run[key] = evil
    run["versions"] = {evil: evil}
    run["seconds"] = {evil: 1.0}
    (folder / "run.json").write_text(json.dumps(run))
    metrics = json.loads((folder / "metrics.json").read_text())
    (folder / "metrics.json").write_text(json.dumps(metrics | {"protocol": evil}))
    text = page_of(folder)
    assert evil not in text and '<b>"' not in text
    page = Page(text)
    assert page.open == []
    assert page.text_of("h1") == [evil]
    assert '<b>"1"' in page.text_of("h3")
    assert f"{evil}0" in page.text_of("button")
    assert 'Photo of <b>"1"' in [picture["alt"] for picture in page.all("img")]


def test_a_model_of_labels_alone_gives_a_page_without_depth_and_3d_view(kept: Path):
    page = Page(page_of(kept / "labels"))
    assert page.alternatives() == {"Photo", "Labels"}
    assert not page.all("canvas") and not page.all("button")
    assert page.text_of("h2") == ["Classes", "Scores", "Photos"]


def test_a_model_of_depth_alone_gives_a_page_without_classes(kept: Path):
    page = Page(page_of(kept / "depth"))
    assert page.alternatives() == {"Photo", "Depth", "Confidence"}
    assert page.text_of("h2") == ["Point cloud", "Scores", "Photos"]
    colorings = [button.get("data-coloring") for button in page.all("button")]
    assert [name for name in colorings if name] == ["photo", "confidence"]


def test_maps_without_confidence_are_not_coloured_by_it(folder: Path):
    index = json.loads((folder / "transforms.json").read_text())
    for frame in index["frames"]:
        del frame["confidence_file_path"]
    (folder / "transforms.json").write_text(json.dumps(index))
    page = Page(page_of(folder))
    assert page.alternatives() == {"Photo", "Depth", "Labels"}
    colorings = [button.get("data-coloring") for button in page.all("button")]
    assert [name for name in colorings if name] == ["photo", "classes"]


def test_an_empty_cloud_is_said_and_the_rest_is_shown(folder: Path):
    for path in (folder / "confidence").iterdir():
        Image.fromarray(np.zeros((48, 64), np.uint8)).save(path)
    page = Page(page_of(folder))
    assert any("no depth passed the filters" in text for text in page.text_of("p"))
    assert not page.all("canvas") and not page.all("button")
    assert page.alternatives() == {"Photo", "Depth", "Confidence", "Labels"}


def test_depth_that_is_unknown_everywhere_has_no_scale(folder: Path):
    photo = read_photos(folder)[0]
    assert photo.depth_path is not None and "depth-scale" in photo_row(photo, SCANNET20)
    Image.fromarray(np.zeros((48, 64), np.uint16)).save(photo.depth_path)
    row = photo_row(photo, SCANNET20)
    assert "no depth known" in row and "depth-scale" not in row


def test_a_row_tells_the_nearest_median_and_farthest_depth(folder: Path):
    depth = np.zeros((48, 64), np.uint16)
    depth[:3, 0] = 500, 2000, 4000
    Image.fromarray(depth).save(folder / "depth" / "0002.png")
    assert "nearest 0.50 m, median 2.00 m, farthest 4.00 m" in Page(page_of(folder)).text_of("p")


def test_scores_are_in_centimetres_and_percent_and_left_out_without_truth(folder: Path):
    metrics = json.loads((folder / "metrics.json").read_text())
    metrics |= {"abs": 0.0957, "rel": 0.0434, "miou": None}
    (folder / "metrics.json").write_text(json.dumps(metrics))
    page = Page(page_of(folder))
    assert page.text_of("dt")[:2] == ["Abs cm", "Rel %"] and "mIoU %" not in page.text_of("dt")
    assert page.text_of("strong")[:2] == ["9.6", "4.3"]
    assert "IoU %" in page.text_of("th")
    metrics["iou"] = [None] * len(metrics["iou"])
    (folder / "metrics.json").write_text(json.dumps(metrics))
    assert "IoU %" not in Page(page_of(folder)).text_of("th")
    (folder / "metrics.json").unlink()
    assert "Scores" not in Page(page_of(folder)).text_of("h2")
    assert "IoU %" not in Page(page_of(folder)).text_of("th")


def test_the_head_tells_the_model_and_the_seconds_of_each_stage(folder: Path):
    run = json.loads((folder / "run.json").read_text())
    run |= {"model": "tiny", "weights_hash": "abc123", "seconds": {"read": 0.5, "decode": 1.25}}
    (folder / "run.json").write_text(json.dumps(run))
    about, cost = Page(page_of(folder)).text_of("p")[:2]
    assert about.startswith("4 photos · ") and "model tiny, weights abc123" in about
    assert "torch " in about
    assert cost == "1.75 s for 4 photos in the last run: read 0.50, decode 1.25"
    (folder / "run.json").unlink()
    assert Page(page_of(folder)).text_of("h1") == ["both"]  # the folder's own name


def test_of_very_many_photos_some_are_shown_evenly_and_the_page_says_so(folder: Path, monkeypatch):
    monkeypatch.setattr(page_module, "MOST_ROWS", 2)
    page = Page(page_of(folder))
    assert page.text_of("h3") == ["0000", "0003"]
    assert any(text.startswith("2 of 4 photos, evenly spaced") for text in page.text_of("p"))
    assert evenly_spaced(range(100), 4) == [0, 33, 66, 99]


def test_progress_is_told_as_often_as_announced(kept: Path):
    for tasks in ("both", "depth", "labels"):
        photos = read_photos(kept / tasks)
        steps = []
        build_page(kept / tasks, photos, CloudSettings(), lambda steps=steps: steps.append(1))
        assert len(steps) == count_steps(photos)


def picture_in(address: str | None) -> Image.Image:
    assert address
    return Image.open(BytesIO(base64.b64decode(address.partition("base64,")[2])))


def test_thumbnails_are_small_and_keep_their_colours(tmp_path: Path):
    Image.new("RGB", (1000, 600), (200, 100, 50)).save(tmp_path / "photo.jpg")
    photo = photo_thumbnail(tmp_path / "photo.jpg")
    assert (photo.width, photo.height) == (480, 288)
    assert picture_in(photo.address).size == (480, 288)
    labels = np.zeros((600, 1000), np.uint8)
    labels[:, 500:] = 7
    shown = picture_in(label_thumbnail(labels, SCANNET20).address)
    assert shown.format == "PNG" and shown.size == (480, 288)
    assert shown.convert("RGB").getpixel((470, 20)) == SCANNET20.colors[7]
    depth = np.tile(np.linspace(1, 4, 100, dtype=np.float32), (40, 1))
    shown = np.asarray(picture_in(depth_thumbnail(depth).address)).astype(int)
    # JPEG changes smooth colours by a few of 255.
    assert np.abs(shown - depth_picture(depth)).mean() < 4


def test_the_command_writes_one_whole_page_and_says_where(folder: Path, tmp_path: Path, capsys):
    Report(folder).run()
    written = folder / "report.html"
    assert f"{written}: " in capsys.readouterr().out
    assert Page(written.read_text(encoding="utf-8")).open == []
    Report(folder, tmp_path / "new" / "room.html").run()
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["room.html"]


@pytest.mark.parametrize(("has_browser", "said"), [(True, "opened"), (False, "no browser found")])
def test_viewing_opens_the_page_that_it_writes(
    folder: Path, monkeypatch, capsys, has_browser: bool, said: str
):
    opened = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) or has_browser)
    View(Report(folder)).run()
    assert opened == [(folder / "report.html").resolve().as_uri()]
    assert (folder / "report.html").is_file() and said in capsys.readouterr().out


def test_without_a_screen_no_browser_is_started(folder: Path, monkeypatch, capsys):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("webbrowser.open", lambda url: pytest.fail("a browser was started"))
    View(Report(folder)).run()
    assert "no browser found here" in capsys.readouterr().out


def test_points_and_cameras_in_the_page_are_bounded(kept: Path, monkeypatch):
    full = Page(page_of(kept / "both")).cloud()
    monkeypatch.setattr("mvsam.apps.report.cloud_data.MOST_POINTS", 200)
    monkeypatch.setattr("mvsam.apps.report.cloud_data.MOST_CAMERAS", 2)
    few = Page(page_of(kept / "both")).cloud()
    assert (
        len(numbers(full["positions"], "<u2", 3)) > 200 >= len(numbers(few["positions"], "<u2", 3))
    )
    assert (
        len(numbers(full["frusta"], "<f4", 48)) == 4 > len(numbers(few["frusta"], "<f4", 48)) == 2
    )


def test_unlabelled_points_are_grey_and_sure_ones_bright(kept: Path):
    cloud = Page(page_of(kept / "depth")).cloud()
    assert set(numbers(cloud["labels"], "u1", 1)[:, 0]) == {IGNORE}
    assert cloud["palette"][IGNORE] == [128, 128, 128]
    assert cloud["unsureToSure"][255] == UNSURE_TO_SURE[-1].tolist()
    half = confidence_thumbnail(np.full((8, 8), 128, np.uint8))
    pixel = np.asarray(picture_in(half.address))[4, 4]
    np.testing.assert_allclose(pixel, confidence_colors(np.array(128 / 255)), atol=3)


def test_a_damaged_depth_map_is_no_reason_for_a_page_without_a_cloud(folder: Path):
    Image.fromarray(np.ones((25, 32), np.uint16)).save(folder / "depth" / "0003.png")
    with pytest.raises(InputError, match=r"0003\.png is smaller than"):
        page_of(folder)


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js to run the page's script")
def test_the_scripts_show_the_scene_upright_and_hide_what_is_hidden():
    scripts = [files("mvsam.apps.report") / name for name in ("orbit.js", "viewer.js")]
    text = "\n".join(script.read_text() for script in scripts).rsplit("start();", 1)[0]
    checks = """
    const view = { up: [0, -1, 0], front: [0, 0, 1], target: [0, 0, 3], pitch: 0, distance: 2 };
    const matrix = new Orbit(view).clipFromWorld(1.5);
    const clip = (x) => [0, 1, 3].map(
      (row) => [...x, 1].reduce((sum, value, column) => sum + value * matrix[4 * column + row], 0));
    const places = [[0, 0, 3], [0, -0.5, 3], [0.5, 0, 3], [0, 0, 4]].map(clip);
    const code = btoa(String.fromCharCode(1, 2, 3, 4, 5, 6)), labels = btoa("\\x07\\xff");
    const paint = new Paint({ colors: code, labels, confidence: labels, palette: [] });
    paint.hidden.add(7);
    console.log(JSON.stringify({ places, colors: [...paint.colors()] }));
    """
    done = subprocess.run(["node", "-e", text + checks], capture_output=True, text=True, check=True)
    result = json.loads(done.stdout)
    (target, above, right, behind) = np.array(result["places"])
    np.testing.assert_allclose(target, [0, 0, 2], atol=1e-6)
    assert above[0] == pytest.approx(0) and above[1] > 0  # up in the scene is up in the picture
    assert right[0] > 0 and right[1] == pytest.approx(0)
    assert behind[2] == pytest.approx(3)
    assert result["colors"] == [1, 2, 3, 0, 4, 5, 6, 255]


def test_a_damaged_folder_is_named_and_leaves_the_old_page(folder: Path):
    Report(folder).run()
    before = (folder / "report.html").read_bytes()
    (folder / "labels" / "0003.png").write_bytes(b"no picture")
    with pytest.raises(InputError, match=r"0003\.png cannot be read"):
        Report(folder).run()
    (folder / "run.json").write_text("{")
    with pytest.raises(InputError, match=r"run\.json is damaged"):
        Report(folder).run()
    (folder / "transforms.json").write_text('{"frames": [{}]}')
    with pytest.raises(InputError, match=r"transforms\.json is damaged"):
        Report(folder).run()
    assert (folder / "report.html").read_bytes() == before


def test_what_is_no_predict_folder_and_a_folder_as_page_are_refused(folder: Path, tmp_path: Path):
    with pytest.raises(InputError, match=r"no transforms\.json"):
        Report(tmp_path).run()
    with pytest.raises(InputError, match="give --out a file"):
        Report(folder, tmp_path).run()
    (folder / "transforms.json").write_text('{"frames": []}')
    with pytest.raises(InputError, match="holds no photos"):
        Report(folder).run()
