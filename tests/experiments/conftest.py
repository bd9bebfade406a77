"""One small data set and one finished run for all tests of the driver."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.experiments.small_run import run
from tests.small import SIDE
from tests.synthetic import write_posed_folder


def write_labelled_folder(folder: Path, baseline: float = 0.1) -> Path:
    """A posed folder in which every pixel has depth and a label."""
    write_posed_folder(folder, 5, (SIDE, SIDE), baseline=baseline)
    for file in (folder / "labels").iterdir():
        labels = np.array(Image.open(file))
        Image.fromarray(np.where(labels == 255, 2, labels).astype(np.uint8)).save(file)
    return folder


@pytest.fixture(scope="session")
def data(tmp_path_factory) -> Path:
    return write_labelled_folder(tmp_path_factory.mktemp("data") / "room")


@pytest.fixture(scope="session")
def finished(data: Path, tmp_path_factory) -> Path:
    """The folder of a run that nobody interrupted."""
    folder = tmp_path_factory.mktemp("whole")
    run(folder, data)
    return folder
