"""Primitives, dice, textures, walls and light: small facts that the pictures rest on."""

import numpy as np
import pytest

from mvsam.rooms import mesh
from mvsam.rooms.dice import Dice
from mvsam.rooms.light import irradiance
from mvsam.rooms.materials import PATTERNS, Material, plain
from mvsam.rooms.plan import Plan, outline_walls
from mvsam.rooms.room import Light, Piece, Room
from mvsam.rooms.smoothing import LightGrid
from mvsam.rooms.textures import albedo, material_table


def volume(soup: mesh.Soup) -> float:
    """By the divergence theorem; right only for a closed, outward-facing soup."""
    a, b, c = soup.corners[:, 0], soup.corners[:, 1], soup.corners[:, 2]
    return float((a * np.cross(b, c)).sum() / 6)


SHAPES = {
    "box": (mesh.box((0, 0, 0), (1, 2, 3)), 6.0, 1e-9),
    "moved box": (mesh.box((4, 5, 6), (5, 7, 9)), 6.0, 1e-9),
    "frustum": (mesh.tapered((0, 0, 0), (1, 1, 1), 0.5), 7 / 12, 1e-9),
    "prism": (mesh.prism(mesh.rounded_outline(2, 1, 0.2, 32), 0, 1), 2 - 0.04 * (4 - np.pi), 1e-3),
    "cylinder": (mesh.cylinder(1, 0, 2, 128), 2 * np.pi, 1e-2),
    "ellipsoid": (mesh.cushion((-1, -1, -1), (1, 1, 1), 1.0, 48), 4 / 3 * np.pi, 2e-2),
}


@pytest.mark.parametrize("name", SHAPES)
def test_closed_shapes_have_their_volume(name):
    soup, expected, tolerance = SHAPES[name]
    assert abs(volume(soup)) == pytest.approx(expected, rel=tolerance)


def test_turning_keeps_normals_perpendicular_to_their_triangles():
    soup = mesh.box((0, 0, 0), (1, 2, 3)).turned(33, "x").turned(-70, "z").moved(1, 2, 3)
    edges = soup.corners[:, 1] - soup.corners[:, 0]
    assert np.abs((edges * soup.normals[:, 0]).sum(axis=1)).max() < 1e-9


def test_a_soft_box_fills_its_bounds():
    corners = mesh.cushion((1, 2, 3), (2, 4, 3.5)).corners.reshape(-1, 3)
    np.testing.assert_allclose(corners.min(axis=0), [1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), [2, 4, 3.5], atol=1e-6)


def test_dice_throw_the_same_numbers_for_ever():
    dice = Dice(1, 2)
    assert [round(dice.uniform(), 6) for _ in range(3)] == [0.448415, 0.430882, 0.419999]
    assert Dice(1, 2).array(4).tolist() == Dice(1, 2).array(4).tolist()
    assert Dice(1, 2).uniform() != Dice(1, 3).uniform()


def test_dice_reach_both_ends_and_respect_weights():
    dice = Dice(5)
    assert {dice.count(1, 3) for _ in range(200)} == {1, 2, 3}
    assert {dice.weighted([0.0, 1.0, 0.0]) for _ in range(50)} == {1}
    assert sorted(dice.shuffled([1, 2, 3])) == [1, 2, 3]


@pytest.mark.parametrize("pattern", [name for name in PATTERNS if name != "image"])
def test_every_pattern_is_a_color_and_calms_down_far_away(pattern):
    material = Material(pattern, (0.6, 0.5, 0.4), (0.1, 0.2, 0.3), 0.1, seed=3.0)
    uv = np.random.default_rng(0).random((2, 4000)).astype(np.float32)
    direction = np.tile(np.array([[0.5], [0.7], [-0.1]], dtype=np.float32), 4000)
    near, far = (
        albedo(
            material_table([material]),
            np.zeros(4000, dtype=int),
            uv,
            np.full(4000, footprint, dtype=np.float32),
            direction,
        )
        for footprint in (1e-4, 3.0)
    )
    assert np.isfinite(near).all() and near.min() >= 0 and near.max() <= 1
    assert far.std(axis=1).max() <= near.std(axis=1).max() + 1e-3


def test_walls_of_a_rectangle_run_round_it_with_the_room_on_the_left():
    walls = outline_walls([(0.0, 0.0, 3.0, 2.0)])
    assert sorted(w.length for w in walls) == [2, 2, 3, 3]
    for wall in walls:
        x, y = wall.point(wall.length / 2, 0.5)
        assert 0 < x < 3 and 0 < y < 2


def test_an_l_shaped_room_has_six_walls():
    walls = outline_walls([(0.0, 0.0, 4.0, 3.0), (0.0, 3.0, 2.0, 5.0)])
    assert len(walls) == 6
    assert sum(w.length for w in walls) == pytest.approx(2 * (4 + 5))


def test_holes_are_left_out_of_the_wall():
    wall = outline_walls([(0.0, 0.0, 3.0, 2.0)])[0]
    wall.holes.append((0.5, 1.0, 0.8, 1.8))
    soup = wall.surface(0.0, 2.5)
    faces = np.cross(
        soup.corners[:, 1] - soup.corners[:, 0], soup.corners[:, 2] - soup.corners[:, 0]
    )
    area = np.linalg.norm(faces, axis=1).sum() / 2
    assert area == pytest.approx(wall.length * 2.5 - 0.5)


def test_a_taken_place_is_refused():
    plan = Plan([(0.0, 0.0, 3.0, 3.0)], 2.5)
    thing = Piece().add(2, plain((0.5, 0.5, 0.5)), mesh.box((-0.5, 0, 0), (0.5, 1, 1)))
    assert plan.put(thing, 0, 1, 1)
    assert not plan.put(thing, 0, 1.2, 1.2)
    assert not plan.put(thing, 0, 2.8, 0), "it would stand in the wall"
    assert plan.put(thing, 0, 1, 1, z=1.2), "above it there is room"


def lit_box(*extra: mesh.Soup) -> Room:
    """A closed 4 m cube with one lamp under the ceiling."""
    piece = Piece().add(0, plain((0.5, 0.5, 0.5)), mesh.box((0, 0, 0), (4, 4, 4)), *extra)
    small = np.eye(3) * 0.01
    piece.lights.append(
        Light(np.array([2, 2, 3.5]), small[0], small[1], np.zeros(3), (4.0, 4.0, 4.0))
    )
    return Room(piece, "test", (0.0, 0.0, 0.0), np.array([[0.0, 0, 4, 4]]))


def light_on_floor(room: Room, x: float, y: float) -> float:
    position = np.array([[x], [y], [0]], dtype=np.float32)
    normal = np.array([[0], [0], [1]], dtype=np.float32)
    phase = np.full((2, 1), 0.5, dtype=np.float32)
    return float(irradiance(room, position, normal, phase)[0, 0])


def test_light_falls_with_the_square_of_the_distance_and_the_cosine():
    room = lit_box()
    below = 4 / (3.5**2 + 0.05)
    assert light_on_floor(room, 2, 2) == pytest.approx(below, rel=0.02)
    squared = 3.5**2 + 1.5**2
    aside = 4 / (squared + 0.05) * 3.5 / np.sqrt(squared)
    assert light_on_floor(room, 3.5, 2) == pytest.approx(aside, rel=0.02)


def test_a_table_casts_a_shadow():
    room = lit_box(mesh.box((1.5, 1.5, 1), (2.5, 2.5, 1.05)))
    assert light_on_floor(room, 2, 2) == 0
    assert light_on_floor(room, 3.7, 2) > 0.1


def test_light_does_not_leak_between_surfaces_that_face_apart():
    surface = np.zeros((6, 8, 8), dtype=np.float32)
    surface[5, :, :4] = 1.0
    surface[3, :, 4:] = 1.0
    light = np.where(surface[5:] > 0, 1.0, 5.0).astype(np.float32)
    smooth = LightGrid(surface, light).smoothed()
    np.testing.assert_allclose(smooth.light, light, atol=1e-6)
    asked = np.array([[0], [0], [0], [0], [0], [1.0]], dtype=np.float32)
    found, agreement = smooth.at(np.array([[7.2], [6.0]]), asked)
    assert found[0, 0] == pytest.approx(1.0) and agreement[0] > 0
