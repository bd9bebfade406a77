import numpy as np
import pytest

from mvsam.reconstruction import fusion
from mvsam.reconstruction.filtering import back_project, project
from mvsam.reconstruction.fusion import (
    UNCONFIRMED,
    Correction,
    Opinion,
    PhotoMaps,
    Surface,
    correction,
    corrections,
    opinion,
)
from mvsam.reconstruction.thinning import ThinnedCamera, thin
from tests.reconstruction.test_filtering import Camera
from tests.synthetic import SyntheticView, synthetic_views


def sure(depth: np.ndarray, confidence: float = 1.0) -> PhotoMaps:
    return PhotoMaps(depth.astype(np.float32), np.full(depth.shape, confidence, np.float32))


def off(depth: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.abs(np.log(depth / truth))


def noisy(views: list[SyntheticView]) -> list[PhotoMaps]:
    """Every map with a mistake of its own of a twentieth."""
    dice = np.random.default_rng(3)
    return [sure(view.depth * np.exp(dice.choice([-0.05, 0.05]))) for view in views]


def said(of: PhotoMaps, source: Camera, target: Camera, depth: np.ndarray) -> Opinion:
    """What one photo says of another, whose depth is `depth`."""
    return opinion(source, of, target, Surface(depth.astype(np.float32)))


def whole(depth: np.ndarray) -> ThinnedCamera:
    """A camera whose maps are not thinned."""
    return thin(depth.shape[::-1], np.eye(3), np.eye(4), 1000)


def here(of: PhotoMaps, depth: np.ndarray) -> Opinion:
    """What a photo says of one that was taken at the same place."""
    camera = Camera(synthetic_views(1)[0])
    camera.size = depth.shape[::-1]
    return said(of, camera, camera, depth)


def test_true_depths_agree():
    first, second = synthetic_views(2)
    heard = said(sure(first.depth, 0.5), Camera(first), Camera(second), second.depth)
    assert heard.is_seen.mean() > 0.5
    assert np.quantile(np.abs(heard.log_ratio[heard.is_seen]), 0.9) < 2e-3
    assert (heard.confidence[heard.is_seen] == 0.5).all()


def test_an_opinion_is_what_a_loop_over_points_says():
    first, second = synthetic_views(2)
    own = sure(1.02 * first.depth, 0.5)
    heard = said(own, Camera(first), Camera(second), second.depth)
    pixels, depth = project(Camera(second), back_project(Camera(first), own.depth))
    nearest: dict[tuple[int, int], float] = {}
    for (x, y), z in zip(pixels.reshape(-1, 2), depth.ravel(), strict=True):
        if 0 <= x < 64 and 0 <= y < 48:
            place = (int(y), int(x))
            nearest[place] = min(z, nearest.get(place, np.inf))
    assert heard.is_seen.sum() == len(nearest) > 1000
    for place, z in nearest.items():
        there = np.log(z / second.depth[place])
        # The depth that it is compared with is that where the point lands, half a pixel off.
        assert heard.log_ratio[place] == pytest.approx(there, abs=0.04)
        assert heard.confidence[place] == 0.5


def test_a_mistake_is_seen_from_elsewhere():
    first, second = synthetic_views(2)
    heard = said(sure(1.03 * first.depth), Camera(first), Camera(second), second.depth)
    assert np.median(heard.log_ratio[heard.is_seen]) == pytest.approx(np.log(1.03), rel=0.1)


def test_the_nearer_of_two_surfaces_hides_the_other():
    (view,) = synthetic_views(1)
    moved = Camera(view)
    moved.world_from_cam = view.world_from_cam.copy()
    moved.world_from_cam[:3, 3] += 0.05 * view.world_from_cam[:3, 0]
    depth = np.full_like(view.depth, 3.0)
    depth[:, 30:] = 1.0  # its pixels move by several, onto those of the wall
    heard = said(sure(depth), Camera(view), moved, np.full_like(depth, 3.0))
    is_near = heard.log_ratio[24] < -1
    edge = np.argmax(is_near)
    assert 20 < edge < 30 and is_near[edge:60].all()


def test_what_is_behind_a_camera_or_beside_its_picture_is_not_seen():
    (view,) = synthetic_views(1)
    turned = Camera(view)
    turned.world_from_cam = view.world_from_cam @ np.diag([-1.0, 1, -1, 1])
    assert not said(sure(view.depth), Camera(view), turned, view.depth).is_seen.any()


def test_unknown_depth_says_nothing_and_stays_unknown():
    depth = np.full((40, 60), 2.0)
    holes = depth.copy()
    holes[:, :30] = 0
    assert here(sure(depth), depth).is_seen.all()
    for heard in (here(sure(holes), depth), here(sure(depth), holes)):
        assert not heard.is_seen[:, :30].any() and heard.is_seen[:, 30:].all()
    better = correction(sure(holes), [here(sure(depth), holes)]).applied(sure(holes), whole(holes))
    assert (better.depth[:, :30] == 0).all() and (better.confidence[:, :30] == 1).all()


def test_opinions_are_averaged_by_confidence():
    depth = np.full((40, 60), 2.0)
    other = here(sure(depth * np.exp(0.01), 0.5), depth)
    ratio = correction(sure(depth, 0.5), [other, other]).log_ratio
    weight = 0.5 * np.exp(-0.1)  # an opinion a tenth of NEAR away
    assert ratio == pytest.approx(0.01 * 2 * weight / (0.5 + 2 * weight), rel=1e-3)


def test_an_opinion_far_away_hardly_counts_but_shakes_the_certainty():
    depth = np.full((40, 60), 2.0)
    agreed, doubted = (
        correction(sure(depth), [here(sure(factor * depth), depth)]) for factor in (1, 3)
    )
    assert np.abs(doubted.log_ratio).max() < 1e-4
    assert agreed.certainty == pytest.approx(1)
    assert doubted.certainty == pytest.approx(UNCONFIRMED, abs=1e-4)


def test_where_nobody_else_sees_anything_all_stays():
    depth = np.full((40, 60), 2.0)
    same = correction(sure(depth, 0), [here(sure(np.zeros_like(depth)), depth)])
    assert (same.log_ratio == 0).all() and (same.certainty == 1).all()


@pytest.mark.parametrize("rounds", [1, 2])
def test_mistakes_of_single_photos_shrink(monkeypatch, rounds: int):
    monkeypatch.setattr(fusion, "ROUNDS", rounds)
    views = synthetic_views(6)
    maps, cameras = noisy(views), [Camera(view) for view in views]
    found = zip(corrections(cameras, maps), maps, views, strict=True)
    better = [off(each.applied(own, whole(own.depth)).depth, v.depth) for each, own, v in found]
    before = [off(own.depth, view.depth) for own, view in zip(maps, views, strict=True)]
    assert np.mean(better) < (0.6, 0.5)[rounds - 1] * np.mean(before)


def test_a_correction_lies_where_its_pixels_do_in_the_photo():
    photo = np.linspace(0.0, 1.0, 1333, dtype=np.float32) * np.ones((1000, 1), np.float32)
    camera = thin((1333, 1000), np.eye(3), np.eye(4), 320)
    small = camera.thinned(photo)
    nothing = np.ones_like(small)
    better = Correction(small, nothing, None, None).applied(sure(np.ones_like(photo)), camera)
    inside = slice(5, 1320)  # beyond the last kept pixel all is as there
    assert np.log(better.depth)[:, inside] == pytest.approx(photo[:, inside], abs=1e-5)


def labelled(depth: np.ndarray, label: int) -> PhotoMaps:
    return sure(depth)._replace(labels=np.full(depth.shape, label, np.uint8))


def test_two_neighbours_outvote_a_label_and_one_does_not():
    depth = np.full((40, 60), 2.0)
    own, other = labelled(depth, 3), here(labelled(depth, 7), depth)
    one, two = (correction(own, others).labels for others in ([other], [other, other]))
    assert one is not None and (one == 3).all()
    assert two is not None and (two == 7).all()


def test_who_sees_another_surface_has_no_vote():
    depth = np.full((40, 60), 2.0)
    behind = here(labelled(1.5 * depth, 7), depth)
    labels = correction(labelled(depth, 3), [behind] * 10).labels
    assert labels is not None and (labels == 3).all()


def test_labels_move_with_their_surface():
    first, second = synthetic_views(2)
    own = sure(first.depth)._replace(labels=first.labels)
    heard = said(own, Camera(first), Camera(second), second.depth)
    assert heard.labels is not None
    assert (heard.labels == second.labels)[heard.is_seen].mean() > 0.95


def test_lines_one_pixel_wide_stay_where_nobody_votes_against_them():
    depth = np.full((40, 60), 2.0)
    own = labelled(depth, 3)
    assert own.labels is not None
    own.labels[:, 20] = 5
    for opinions in ([], [here(sure(0 * depth)._replace(labels=own.labels), depth)] * 3):
        labels = correction(own, opinions).labels
        np.testing.assert_array_equal(labels, own.labels)


def test_labels_of_the_photo_s_own_size_change_where_they_are_outvoted():
    own = sure(np.ones((80, 80)))._replace(labels=np.full((80, 80), 4, np.uint8))
    assert own.labels is not None
    own.labels[:, 11] = 9  # finer than the thinned map
    camera = thin((80, 80), np.eye(3), np.eye(4), 20)
    diagonal = np.add.outer(np.arange(20), np.arange(20))
    labels = np.where(diagonal < 19, 4, 6).astype(np.uint8)
    nothing = np.zeros((20, 20), np.float32)
    better = Correction(nothing, nothing, labels, labels == 6).applied(own, camera)
    assert better.labels is not None and set(np.unique(better.labels)) == {4, 6, 9}
    assert (better.labels[:50, 11] == 9).all()  # the others saw nothing else there
    wanted = np.where(np.add.outer(np.arange(80), np.arange(80)) < 78, own.labels, 6)
    assert (better.labels == wanted).mean() > 0.97  # borders without steps
