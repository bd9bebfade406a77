from pathlib import Path

import pytest

from mvsam.data.formats import open_scene
from mvsam.inference.scene import predict_scene
from tests.inference.fake_model import FakeModel
from tests.synthetic import write_posed_folder

SIZE = (128, 96)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A `predict` folder of the box room, its depth true (at the photo's size)."""
    write_posed_folder(tmp_path / "room", 4, SIZE)
    model = FakeModel()
    model.input_size = SIZE
    predict_scene(model, open_scene(tmp_path / "room"), tmp_path / "out", fuse=False)
    return tmp_path / "out"
