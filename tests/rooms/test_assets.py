"""Meshes and pictures of a pack among the parametric things."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from mvsam import rooms
from mvsam.errors import InputError
from mvsam.rooms.assets import open_assets
from mvsam.rooms.classes import CHAIR
from mvsam.rooms.dice import Dice
from mvsam.rooms.pictures import pyramid
from tests.reference.rays import first_hit

MODELS = "file,class,mount,front,typical_z,size_z,rooms\nmodels/box.glb,chair,floor,+y,,0.6,any\n"
TEXTURES = "file,suitable_for,tileable,metres\ntextures/red.png,floor wall,yes,0.5\n"


@pytest.fixture(scope="module")
def pack(tmp_path_factory) -> str:
    """A textured box that is a chair, and a picture half red and half black."""
    folder: Path = tmp_path_factory.mktemp("assets")
    for name in ("models", "textures"):
        (folder / name).mkdir()
    box = trimesh.creation.box((0.4, 0.4, 0.6)).apply_translation((0, 0, 0.3))
    skin = Image.new("RGB", (4, 4), (20, 200, 20))
    box.visual = trimesh.visual.TextureVisuals(  # pyright: ignore[reportAttributeAccessIssue]
        uv=box.vertices[:, :2], image=skin
    )
    trimesh.Scene({"chair.0": box}).export(folder / "models" / "box.glb")
    pixels = np.zeros((8, 8, 3), np.uint8)
    pixels[:, :4, 0] = 255
    Image.fromarray(pixels).save(folder / "textures" / "red.png")
    (folder / "models.csv").write_text(MODELS)
    (folder / "textures.csv").write_text(TEXTURES)
    return str(folder)


def test_a_model_stands_with_its_back_at_the_wall_and_keeps_its_class(pack: str):
    found = open_assets(pack).thing(Dice(1), "floor", "kitchen")
    assert found is not None
    piece, height = found
    low, high = piece.bounds()
    assert height == 0 and low[1] == pytest.approx(0, abs=1e-6)
    assert 0.5 < high[2] < 0.7 and {label for _, label, _ in piece.parts} == {CHAIR}
    assert open_assets(pack).thing(Dice(1), "wall", "kitchen") is None


def test_rooms_have_some_of_the_pack_and_exact_depth_all_the_same(pack: str):
    scenes = [rooms.scene("val", index, 1, 40, 32, assets=pack) for index in range(6)]
    pictures = [{id(x) for x in scene.room.materials.images if x is not None} for scene in scenes]
    assert sum(map(bool, pictures)) >= 3
    scene, frame = scenes[0], scenes[0].frame(0)
    rotation, origin = frame.world_from_cam[:3, :3], frame.world_from_cam[:3, 3]
    direction = rotation @ np.linalg.solve(frame.intrinsics, [20.5, 16.5, 1.0])
    triangle, distance = first_hit(scene.room.triangles, origin, direction)
    assert frame.depth is not None and frame.labels is not None
    assert frame.depth[16, 20] == pytest.approx(distance, rel=1e-4)
    assert frame.labels[16, 20] == scene.room.labels[triangle]


def test_a_folder_without_the_lists_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match=r"models\.csv: no such file"):
        open_assets(str(tmp_path))


def test_a_picture_is_itself_near_by_its_mean_far_away_and_repeats(pack: str):
    shown = pyramid(str(Path(pack) / "textures" / "red.png"))
    places = np.array([[0.1875, 0.5], [0.6875, 0.5], [1.1875, -3.5]]).T
    near = shown.at(places, np.full(3, 1e-4))
    np.testing.assert_allclose(near[0], [1, 0, 1], atol=1e-5)
    far = shown.at(places, np.full(3, 100.0))
    np.testing.assert_allclose(far[0], 0.5, atol=1e-5)
