import numpy as np
import pytest
import torch

from mvsam.build import build
from mvsam.data.dataset import make_views
from mvsam.data.formats import open_scene
from mvsam.inference.session import Session
from mvsam.precision import autocast
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
    session = Session(model, RANGE)
    session.size = SIZE
    tuple_ = [frames[index] for index in order]
    session.predict([frames[3], frames[0]])  # so that some photos are remembered already
    got = session.predict(tuple_)
    with torch.inference_mode(), autocast("cpu"):
        wanted = model(make_views(tuple_, SIZE, RANGE))
    assert got.depth is not None and got.confidence is not None and got.labels is not None
    # Encoding photos one by one sums in another order than encoding them as a batch.
    np.testing.assert_allclose(got.depth, wanted.depth[0], rtol=1e-3)
    np.testing.assert_allclose(got.confidence, wanted.confidence[0], atol=1e-3)
    assert np.mean(got.labels == wanted.labels[0].numpy()) > 0.99


def test_the_reference_may_stand_anywhere(frames):
    session = Session(FakeModel(), RANGE)
    first = session.predict(frames[:3], reference=1)
    second = session.predict([frames[1], frames[0], frames[2]])
    np.testing.assert_array_equal(first.depth, second.depth)
    np.testing.assert_array_equal(first.labels, second.labels)


def test_photos_not_seen_for_long_are_forgotten(frames):
    model = FakeModel()
    session = Session(model, RANGE, remembered_photos=2)
    for pair in ([0, 1], [1, 0], [1, 2], [1, 2]):
        session.predict([frames[index] for index in pair])
    assert model.encoded_views == 3
    session.predict([frames[0], frames[1]])
    assert model.encoded_views == 5  # 0 was forgotten for 2, and 1 went to make room for 0
