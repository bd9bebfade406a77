import threading
from dataclasses import replace

import numpy as np
import pytest
import torch

from mvsam.build import build
from mvsam.data.dataset import make_views
from mvsam.data.formats import open_scene
from mvsam.errors import InputError
from mvsam.inference.session import Session
from mvsam.precision import autocast
from mvsam.types import Frame
from tests.inference.fake_model import FakeModel
from tests.synthetic import write_posed_folder

SIZE = (64, 64)
RANGE = (0.5, 5.0)


@pytest.fixture
def frames(tmp_path):
    write_posed_folder(tmp_path / "room", 4, SIZE)
    scene = open_scene(tmp_path / "room")
    return [scene.frame(index) for index in range(4)]


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 3]])
def test_remembered_features_give_what_a_single_call_gives(frames, order: list[int]):
    torch.manual_seed(0)
    model = build("tiny").eval()
    # A random network's classes are nearly equal: bfloat16 would decide between them.
    session = Session(model, RANGE, precision="float32")
    session.size = SIZE
    tuple_ = [frames[index] for index in order]
    session.predict([frames[3], frames[0]])  # so that some photos are remembered already
    got = session.predict(tuple_)
    with torch.inference_mode():
        wanted = model(make_views(tuple_, SIZE, RANGE))
    assert got.depth is not None and got.confidence is not None and got.labels is not None
    # Encoding photos one by one sums in another order than encoding them as a batch.
    np.testing.assert_allclose(got.depth, wanted.depth[0], rtol=1e-3)
    np.testing.assert_allclose(got.confidence, wanted.confidence[0], atol=1e-3)
    assert np.mean(got.labels == wanted.labels[0].numpy()) > 0.99


def test_tuples_one_after_another_give_what_each_gives_alone(frames):
    torch.manual_seed(0)
    model = build("tiny").eval()
    tuples = [[frames[index] for index in order] for order in ([0, 1], [1, 2], [3, 2], [0, 3])]
    with Session(model, RANGE, remembered_photos=2) as session:
        session.size = SIZE
        together = list(session.predict_all(tuples))
    for got, tuple_ in zip(together, tuples, strict=True):
        alone = Session(model, RANGE)
        alone.size = SIZE
        wanted = alone.predict(tuple_)
        np.testing.assert_array_equal(got.depth, wanted.depth)
        np.testing.assert_array_equal(got.labels, wanted.labels)


def test_the_photos_of_the_next_tuple_are_read_beside_the_network(frames):
    read: list[str] = []
    next_one_is_read = threading.Event()

    def watched(frame: Frame) -> Frame:
        def load() -> np.ndarray:
            assert threading.current_thread() is not threading.main_thread()
            read.append(frame.name)
            if frame.name == "0002":
                next_one_is_read.set()
            return frame.image

        return replace(frame, load_image=load)

    seen = [watched(frame) for frame in frames]
    with Session(FakeModel(), RANGE) as session:
        predictions = session.predict_all([seen[:2], seen[1:3], seen[2:]])
        next(predictions)
        assert next_one_is_read.wait(timeout=60)  # though the second tuple was not asked for yet
        assert read == ["0000", "0001", "0002"]
        list(predictions)
    assert read == ["0000", "0001", "0002", "0003"]


def test_a_photo_that_cannot_be_read_ahead_is_named_when_its_turn_comes(frames):
    def fail() -> np.ndarray:
        raise InputError("0002.png is damaged: remove it.")

    broken = replace(frames[2], load_image=fail)
    with Session(FakeModel(), RANGE) as session:
        predictions = session.predict_all([frames[:2], [frames[0], broken]])
        next(predictions)
        with pytest.raises(InputError, match=r"0002\.png is damaged"):
            next(predictions)


def test_a_session_that_is_left_early_ends_its_thread(frames):
    before = threading.active_count()
    with Session(FakeModel(), RANGE) as session:
        next(session.predict_all([frames[:2], frames[2:]]))
    assert threading.active_count() == before


def test_the_model_stays_as_it_was():
    model = build("cas_mvsnet").train()
    before = list(model.modules())
    Session(model, RANGE)
    assert list(model.modules()) == before and all(module.training for module in before)


def test_photos_not_seen_for_long_are_forgotten(frames):
    model = FakeModel()
    session = Session(model, RANGE, remembered_photos=2)
    for pair in ([0, 1], [1, 0], [1, 2], [1, 2]):
        session.predict([frames[index] for index in pair])
    assert model.encoded_views == 3
    session.predict([frames[0], frames[1]])
    assert model.encoded_views == 5  # 0 was forgotten for 2, and 1 went to make room for 0


def test_a_model_trained_with_photos_for_sam_is_given_them(frames):
    torch.manual_seed(0)
    model = build("tiny").eval()
    model.semantic_size = (96, 64)
    session = Session(model, RANGE)
    session.size = SIZE
    got = session.predict(frames[:2])
    with torch.inference_mode(), autocast("cpu"):
        wanted = model(make_views(frames[:2], SIZE, RANGE, (96, 64)))
    assert got.depth is not None
    np.testing.assert_allclose(got.depth, wanted.depth[0], rtol=1e-3)


@pytest.mark.parametrize("reads_depth", [True, False])
def test_measured_depth_is_decoded_for_models_that_read_it_alone(frames, reads_depth: bool):
    decoded = []

    def with_depth(frame: Frame) -> Frame:
        def load() -> np.ndarray:
            decoded.append(frame.name)
            return np.full((SIZE[1], SIZE[0]), 2.0, np.float32)

        return replace(frame, load_depth=load)

    with Session(FakeModel(reads_depth=reads_depth), RANGE) as session:
        session.predict([with_depth(frame) for frame in frames[:2]])
    assert bool(decoded) == reads_depth
