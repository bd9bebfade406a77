from pathlib import Path

import pytest

from mvsam.model import MultiViewSAM
from mvsam.weights import files, save
from tests.small import shuffle_statistics, small_model


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """`load` builds the small models."""
    monkeypatch.setattr(
        files, "build", lambda name, classes, **options: small_model(name, classes, **options)
    )


def trained(name: str = "cas_mvsnet", num_classes: int = 20) -> MultiViewSAM:
    model = small_model(name, num_classes, seed=7).eval()
    shuffle_statistics(model)
    return model


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    save(trained(), tmp_path / "cas.safetensors", "cas_mvsnet")
    return tmp_path / "cas.safetensors"
