import numpy as np
import pytest

from mvsam.data.frusta import Cameras, angle_preference, frustum_overlap
from mvsam.data.keyframes import keyframes
from mvsam.data.readers.posed_folder import PosedFolder
from mvsam.data.sampling import (
    KEYFRAME_ANGLE_DEG,
    KEYFRAME_BASELINE,
    evenly_spaced,
    rank_sources,
    view_tuples,
)
from mvsam.errors import InputError
from mvsam.types import Frame
from tests.synthetic import write_posed_folder

DEPTH_RANGE = (0.1, 5.0)
INTRINSICS = np.array([[100.0, 0, 80], [0, 100.0, 60], [0, 0, 1]])


def no_pixels():
    raise AssertionError("ranking must not read pictures")


def frame(name: str, position, yaw_deg: float = 0.0) -> Frame:
    angle = np.deg2rad(yaw_deg)
    pose = np.eye(4)
    pose[[0, 0, 2, 2], [0, 2, 0, 2]] = np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)
    pose[:3, 3] = position
    return Frame(name, (160, 120), INTRINSICS, pose, no_pixels)


def slow_overlap(first: Frame, second: Frame, columns=6, rows=5, slices=4) -> float:
    """Twin: project one point after the other, both ways, and take the smaller share."""
    shares = []
    for reference, source in ((first, second), (second, first)):
        inside = 0
        for row in range(rows):
            for column in range(columns):
                for part in range(slices):
                    depth = DEPTH_RANGE[0] + (part + 0.5) / slices * (
                        DEPTH_RANGE[1] - DEPTH_RANGE[0]
                    )
                    pixel = [(column + 0.5) / columns * 160, (row + 0.5) / rows * 120, 1]
                    point = np.append(np.linalg.inv(INTRINSICS) @ pixel * depth, 1)
                    x, y, z, _ = (
                        np.linalg.inv(source.world_from_cam) @ reference.world_from_cam @ point
                    )
                    u, v = 100 * x / z + 80, 100 * y / z + 60
                    inside += z > 0 and 0 <= u <= 160 and 0 <= v <= 120
        shares.append(inside / (rows * columns * slices))
    return min(shares)


@pytest.mark.parametrize(
    "second",
    [
        frame("b", (0.2, 0, 0)),
        frame("b", (0.1, 0.3, -0.8), 25),
        frame("b", (-0.4, 0, 0.5), -40),
        frame("b", (0, 0, 0), 180),
    ],
)
def test_overlap_is_the_share_of_frustum_points_seen_both_ways(second):
    first = frame("a", (0, 0, 0))
    shared = frustum_overlap(Cameras.of([first, second]), DEPTH_RANGE)
    assert shared[0, 1] == shared[1, 0]
    assert shared[0, 1] == pytest.approx(slow_overlap(first, second), abs=1e-6)


def test_identical_views_overlap_fully_and_opposite_ones_not_at_all():
    frames = [frame("a", (0, 0, 0)), frame("b", (0, 0, 0)), frame("c", (0, 0, 0), 180)]
    shared = frustum_overlap(Cameras.of(frames), DEPTH_RANGE)
    np.testing.assert_array_equal(shared, [[0, 1, 0], [1, 0, 0], [0, 0, 0]])


def test_moving_the_world_changes_no_ranking():
    frames = [frame(str(i), (0.1 * i, 0.02 * i, 0), 4 * i) for i in range(5)]
    moved_world = frame("", (3, -2, 1), 70).world_from_cam
    moved = [
        Frame(f.name, f.size, f.intrinsics, moved_world @ f.world_from_cam, no_pixels)
        for f in frames
    ]
    assert rank_sources(frames, DEPTH_RANGE, 4) == rank_sources(moved, DEPTH_RANGE, 4)


def test_angles_between_5_and_10_degrees_at_mid_depth_are_preferred():
    mid_depth = sum(DEPTH_RANGE) / 2

    def preference(angle_deg: float) -> float:
        baseline = 2 * mid_depth * np.tan(np.deg2rad(angle_deg) / 2)
        cameras = Cameras.of([frame("a", (0, 0, 0)), frame("b", (baseline, 0, 0))])
        return angle_preference(cameras, DEPTH_RANGE)[0, 1]

    assert preference(8) > 0.99
    assert preference(0.5) < preference(2) < preference(4) < preference(6)
    assert preference(8) > preference(15) > preference(25) > preference(40)


def test_sources_come_best_first_and_are_cut_to_the_number_of_views():
    frames = [
        frame("reference", (0, 0, 0)),
        frame("turned away", (0.3, 0, 0), 40),
        frame("good", (0.3, 0, 0)),
        frame("short baseline", (0.05, 0, 0)),
    ]
    tuples, skipped = rank_sources(frames, DEPTH_RANGE, num_views=4)
    assert skipped == []
    assert tuples[0][:2] == (0, 2)
    assert set(tuples[0]) == {0, 1, 2, 3}
    assert rank_sources(frames, DEPTH_RANGE, num_views=2)[0][0] == (0, 2)


def test_views_nearer_than_the_minimum_baseline_come_last():
    frames = [
        frame("reference", (0, 0, 0)),
        frame("at 1 cm", (0.01, 0, 0)),
        frame("at 2 cm", (0.02, 0, 0)),
        frame("far and turned", (0.8, 0, 0), 15),
    ]
    tuples, _ = rank_sources(frames, DEPTH_RANGE, num_views=4)
    assert tuples[0] == (0, 3, 2, 1)
    assert rank_sources(frames, DEPTH_RANGE, 4, minimum_baseline=0.005)[0][0][-1] == 1


def test_views_that_are_all_too_near_are_still_used():
    frames = [frame(str(i), (0.01 * i, 0, 0), 3 * i) for i in range(3)]
    tuples, skipped = rank_sources(frames, DEPTH_RANGE, num_views=3)
    assert tuples[0] == (0, 2, 1)
    assert skipped == []


def test_a_frame_that_nobody_overlaps_is_skipped_by_name():
    frames = [frame("a", (0, 0, 0)), frame("lonely", (0, 0, 0), 180), frame("b", (0.2, 0, 0))]
    tuples, skipped = rank_sources(frames, DEPTH_RANGE, num_views=3)
    assert tuples == [(0, 2), (2, 0)]
    assert skipped == ["lonely"]


def test_prescribed_tuples_are_kept_and_cut(tmp_path):
    write_posed_folder(tmp_path, num_frames=4)
    (tmp_path / "views.txt").write_text("0003 0000 0001 0002\n0001 0002\n")
    tuples, skipped = view_tuples(PosedFolder(tmp_path), 3, DEPTH_RANGE)
    assert tuples == [(3, 0, 1), (1, 2)]
    assert skipped == []


def turn_away(folder, index: int) -> None:
    """Lets one camera look backward."""
    file = folder / f"poses/{index:04d}.txt"
    np.savetxt(file, np.loadtxt(file) @ np.diag([-1.0, 1, -1, 1]))


@pytest.mark.parametrize("prescribed", [True, False])
def test_a_single_blind_reference_is_skipped_by_name(tmp_path, prescribed):
    write_posed_folder(tmp_path, num_frames=4, views=prescribed)
    turn_away(tmp_path, 2)
    tuples, skipped = view_tuples(PosedFolder(tmp_path), 2, DEPTH_RANGE)
    assert [views[0] for views in tuples] == [0, 1, 3]
    assert skipped == ["0002"]


@pytest.mark.parametrize("prescribed", [True, False])
def test_a_scene_in_which_nothing_overlaps_is_refused(tmp_path, prescribed):
    write_posed_folder(tmp_path, num_frames=2, views=prescribed)
    turn_away(tmp_path, 1)
    with pytest.raises(InputError, match=r"no photo overlaps its sources between 0\.1 and 5 m;"):
        view_tuples(PosedFolder(tmp_path), 3, DEPTH_RANGE)


def test_a_single_photo_is_refused(tmp_path):
    write_posed_folder(tmp_path, num_frames=1)
    with pytest.raises(InputError, match="at least two posed photos, found 1; add more"):
        view_tuples(PosedFolder(tmp_path), 3, DEPTH_RANGE)


def test_with_one_view_every_photo_stands_alone(tmp_path):
    write_posed_folder(tmp_path)
    assert view_tuples(PosedFolder(tmp_path), 1, DEPTH_RANGE) == ([(0,), (1,), (2,)], [])


def test_with_one_view_the_prescribed_references_stand_alone(tmp_path):
    write_posed_folder(tmp_path, num_frames=4)
    (tmp_path / "views.txt").write_text("0003 0000 0001\n0001 0002\n")
    assert view_tuples(PosedFolder(tmp_path), 1, DEPTH_RANGE) == ([(3,), (1,)], [])


def test_sources_of_a_long_recording_are_keyframes():
    frames = [frame(str(index), (0.002 * index, 0, 0)) for index in range(450)]
    kept = set(keyframes([f.world_from_cam for f in frames], KEYFRAME_BASELINE, KEYFRAME_ANGLE_DEG))
    tuples, skipped = rank_sources(frames, DEPTH_RANGE, num_views=3)
    assert not skipped and len(tuples) == 450
    assert {source for views in tuples for source in views[1:]} <= kept


def test_a_recording_that_hardly_moves_has_sources_all_the_same():
    frames = [frame(str(index), (0.0001 * index, 0, 0)) for index in range(450)]
    tuples, skipped = rank_sources(frames, DEPTH_RANGE, num_views=3)
    assert not skipped and all(len(views) == 3 for views in tuples)


def test_no_view_at_all_is_refused(tmp_path):
    write_posed_folder(tmp_path)
    with pytest.raises(InputError, match="0 views are none"):
        view_tuples(PosedFolder(tmp_path), 0, DEPTH_RANGE)


def test_evenly_spaced_keeps_both_ends_and_the_order():
    tuples = [(i, i + 1) for i in range(41)]
    chosen = evenly_spaced(tuples, 24)
    assert len(set(chosen)) == 24
    assert chosen == sorted(chosen)
    assert chosen[0] == tuples[0]
    assert chosen[-1] == tuples[-1]
    gaps = np.diff([views[0] for views in chosen])
    assert set(gaps) <= {1, 2}
    assert evenly_spaced(tuples, None) == tuples
    assert evenly_spaced(tuples[:3], 24) == tuples[:3]
    assert evenly_spaced(tuples, 1) == tuples[:1]
