import inspect
from types import SimpleNamespace

import numpy as np
import pytest

from mvsam.data.depth_range import checked_depth_range
from mvsam.errors import InputError
from mvsam.inference.photos import predict
from tests.inference.fake_model import FakeModel, WholeModel
from tests.synthetic import synthetic_views

TO_OPENCV = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


def photos(num_frames: int = 3, size: tuple[int, int] = (128, 96)):
    views = synthetic_views(num_frames, size)
    return (
        [view.image for view in views],
        [view.intrinsics - TO_OPENCV for view in views],
        [view.world_from_cam for view in views],
    )


def test_every_photo_is_a_reference_by_default_and_is_encoded_once():
    model = FakeModel(reads_depth=False)
    results = predict(model, *photos(4))
    assert len(results) == 4
    assert model.encoded_views == 4


def test_results_have_the_size_of_their_photo():
    images, intrinsics, poses = photos(2)
    images[1] = images[1][:60, :100]
    small, cut = predict(FakeModel(reads_depth=False), images, intrinsics, poses, fuse=False)
    assert small.depth is not None and cut.depth is not None
    assert small.depth.shape == (96, 128) and small.depth.dtype == np.float32
    assert cut.depth.shape == (60, 100)
    assert cut.confidence is not None and cut.confidence.dtype == np.float32
    assert cut.labels is not None and cut.labels.dtype == np.uint8
    np.testing.assert_allclose(cut.confidence, 0.75)


def test_several_references_correct_each_other():
    alone = predict(FakeModel(reads_depth=False), *photos(3), fuse=False)
    together = predict(FakeModel(reads_depth=False), *photos(3))
    (one,) = predict(FakeModel(reads_depth=False), *photos(3), references=[0])
    first, fused = alone[0], together[0]
    assert first.depth is not None and fused.depth is not None and one.depth is not None
    np.testing.assert_array_equal(one.depth, first.depth)  # nobody to correct it
    assert fused.depth.dtype == np.float32 and (fused.depth != first.depth).any()


def test_the_reference_comes_first_and_its_intrinsics_fit_the_network_size():
    model = FakeModel(reads_depth=False)
    images, intrinsics, poses = photos(3)
    predict(model, images, intrinsics, poses, references=[2])
    (views,) = model.decoded
    relative = np.linalg.inv(poses[2]) @ poses[0]
    first, second = views.world_from_cam[0, :2].numpy()
    got = np.linalg.inv(first) @ second
    np.testing.assert_allclose(got, relative, atol=1e-6)
    expected = (intrinsics[2] + TO_OPENCV) * [[0.5], [0.5], [1]]
    np.testing.assert_allclose(views.intrinsics[0, 0], expected, atol=1e-5)


def test_a_model_without_encode_is_called_as_a_whole():
    results = predict(WholeModel(), *photos(2))
    assert all(r.depth is not None and r.labels is None for r in results)


def test_the_model_keeps_its_training_mode():
    model = FakeModel(reads_depth=False).train()
    predict(model, *photos(2))
    assert model.training


def broken(part: int, index: int, value) -> list:
    parts = [list(part) for part in photos(3)]
    parts[part][index] = value
    return parts


TRANSPOSED = np.eye(4)
TRANSPOSED[3, :3] = 1
SCALED = np.diag([2.0, 2, 2, 1])


@pytest.mark.parametrize(
    ("parts", "complaint"),
    [
        (broken(0, 1, np.zeros((48, 64, 3), np.float32)), "photo 1: the image is float32"),
        (broken(0, 2, np.zeros((48, 64), np.uint8)), "photo 2: the image"),
        (broken(1, 2, np.eye(4)), "photo 2: the intrinsics has shape"),
        (broken(1, 0, np.diag([-1.0, 1, 1])), "photo 0: the focal lengths must be positive"),
        (broken(2, 1, np.eye(3)), "photo 1: the pose has shape"),
        (broken(2, 1, np.full((4, 4), np.nan)), "photo 1: the pose is not finite"),
        (broken(2, 1, TRANSPOSED), "photo 1: .* transposed"),
        (broken(2, 1, SCALED), "photo 1: the pose is not rigid"),
        ([*(part[:2] for part in photos(2)[:2]), []], "2 images, 2 intrinsics and 0"),
        ([part[:1] for part in photos(1)], "1 photo given; give 2 to 8"),
    ],
)
def test_bad_photos_are_named(parts: list, complaint: str):
    with pytest.raises(InputError, match=complaint):
        predict(FakeModel(reads_depth=False), *parts)


@pytest.mark.parametrize("depth_range", [(0.0, 5.0), (2.0, 1.0), (0.1, float("nan"))])
def test_a_depth_range_must_be_one(depth_range: tuple[float, float]):
    with pytest.raises(InputError, match="depth range"):
        predict(FakeModel(reads_depth=False), *photos(2), depth_range=depth_range)


def test_a_depth_range_may_be_an_array():
    assert inspect.unwrap(checked_depth_range)(np.array([0.5, 2.0])) == (0.5, 2.0)


def test_references_are_a_list():
    with pytest.raises(InputError, match=r"give a list of the photos' numbers"):
        inspect.unwrap(predict)(FakeModel(reads_depth=False), *photos(2), references=0)


@pytest.mark.parametrize("depth_range", [5, "Auto", (1, 2, 3)])
def test_a_depth_range_is_two_numbers(depth_range):
    with pytest.raises(InputError, match=r"give \(nearest, farthest\)"):
        inspect.unwrap(checked_depth_range)(depth_range)


def test_cameras_that_seem_wrong_are_warned_about(monkeypatch, caplog):
    monkeypatch.setattr(
        "mvsam.inference.photos.camera_warning", lambda frames, depth_range: "transpose them"
    )
    predict(FakeModel(reads_depth=False), *photos(2), check_cameras=False)
    assert not caplog.text
    predict(FakeModel(reads_depth=False), *photos(2))
    assert "transpose them" in caplog.text


def test_one_camera_may_have_taken_all_photos():
    images, intrinsics, poses = photos(3)
    one = predict(FakeModel(reads_depth=False), images, np.asarray(intrinsics[0]), poses)
    each = predict(FakeModel(reads_depth=False), images, intrinsics, poses)
    for first, second in zip(one, each, strict=True):
        assert first.depth is not None and second.depth is not None
        assert np.array_equal(first.depth, second.depth)


def test_references_may_come_from_a_generator():
    predict_unchecked = inspect.unwrap(predict)
    assert (
        len(
            predict_unchecked(
                FakeModel(reads_depth=False), *photos(3), references=(i for i in (0, 2))
            )
        )
        == 2
    )


def test_references_may_be_numpy_s_integers_but_no_fractions():
    predict_unchecked = inspect.unwrap(predict)
    assert (
        len(
            predict_unchecked(FakeModel(reads_depth=False), *photos(3), references=np.array([0, 2]))
        )
        == 2
    )
    with pytest.raises(InputError, match=r"reference 1\.0 is not a photo"):
        predict_unchecked(FakeModel(reads_depth=False), *photos(3), references=[1.0])


def test_an_unknown_precision_is_refused():
    with pytest.raises(InputError, match="one of auto, float32, bfloat16"):
        inspect.unwrap(predict)(FakeModel(reads_depth=False), *photos(2), precision="float16")


def test_a_model_of_single_pictures_takes_one_photo():
    model = FakeModel(reads_depth=False)
    model.info = SimpleNamespace(model="segnet", depth_range=(0.1, 5.0))
    assert len(predict(model, *photos(1))) == 1


def test_an_unknown_reference_is_refused():
    with pytest.raises(InputError, match="numbered 0 to 1"):
        predict(FakeModel(reads_depth=False), *photos(2), references=[2])
