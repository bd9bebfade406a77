"""The pictures of tables: bars, and Table 6's depth maps."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mvsam.apps.tables import grid
from mvsam.apps.tables.contents import lines_of
from mvsam.apps.tables.figure import draw_bars
from mvsam.apps.tables.grid import PictureRow, Pictures, collect, draw_grid
from mvsam.data.dataset import make_targets, make_views
from mvsam.data.readers.posed_folder import PosedFolder
from mvsam.errors import InputError
from mvsam.experiments.row_training import Folders
from mvsam.experiments.runs import BUDGETS
from mvsam.experiments.tables import TABLES
from mvsam.inference.pictures import depth_colors, depth_limits, depth_picture
from mvsam.weights import save
from tests.experiments.made_up import write_seeds
from tests.small import SIDE, small_model
from tests.synthetic import write_posed_folder

pytestmark = pytest.mark.filterwarnings("ignore:.*:DeprecationWarning")  # matplotlib's parsers


@pytest.mark.parametrize("number", [1, 3])
def test_bars_are_drawn_with_some_rows_missing(number: int, tmp_path: Path):
    write_seeds(tmp_path / "runs", BUDGETS["rooms"]["cas_mvsnet"], abs=[0.2, 0.3], rel=[0.1, 0.2])
    write_seeds(tmp_path / "runs", BUDGETS["rooms"]["segnet"], 600, miou=[0.1])
    lines = lines_of(TABLES[number], "rooms", tmp_path)
    draw_bars(TABLES[number], lines, tmp_path / "new" / "bars.png")
    colors = np.unique(np.array(Image.open(tmp_path / "new" / "bars.png").convert("RGB")))
    assert len(colors) > 10


def test_a_figure_in_an_unknown_form_is_refused(tmp_path: Path):
    lines = lines_of(TABLES[3], "rooms", tmp_path)
    with pytest.raises(InputError, match=r"bars\.xyz must end in one of: .*png"):
        draw_bars(TABLES[3], lines, tmp_path / "bars.xyz")
    assert not list(tmp_path.iterdir())


@pytest.fixture
def columns(tmp_path: Path, monkeypatch) -> list:
    """Two columns of a posed folder, in place of the rooms of the test split."""
    write_posed_folder(tmp_path / "room", 3, (SIDE, SIDE))
    scene = PosedFolder(tmp_path / "room")
    frames = [scene.frame(index) for index in range(3)]
    sample = make_views(frames, (SIDE, SIDE)), make_targets(frames[0], (SIDE, SIDE))
    columns = [("one", sample), ("two", sample)]
    monkeypatch.setattr(grid, "_columns", lambda budget: columns)
    return columns


def test_the_grid_shows_what_is_trained_and_says_what_is_missing(columns: list, tmp_path: Path):
    folders = Folders(tmp_path / "runs", tmp_path / "results")
    model = small_model("tiny_cas_mvsnet")
    path = folders.runs / "cas_mvsnet_rooms-0" / "model.safetensors"
    save(model, path, "tiny_cas_mvsnet")
    write_seeds(folders.results, BUDGETS["rooms"]["cas_mvsnet"], 600, rel=[0.1])
    pictures = collect("rooms", folders)
    assert pictures.titles == ["one", "two"]
    labels = {row.method: row.depths for row in pictures.rows}
    assert list(labels) == ["MTAN\nmissing", "CasMVSNet\nnot converged", "Ours\nmissing"]
    depths = labels["CasMVSNet\nnot converged"]
    assert labels["Ours\nmissing"] is None and depths is not None
    assert [depth.shape for depth in depths] == [(SIDE, SIDE)] * 2
    draw_grid(pictures, tmp_path / "table6.png")
    assert np.array(Image.open(tmp_path / "table6.png")).shape[1] > 300


def test_maps_of_a_column_share_the_colours_of_its_true_depth(monkeypatch, tmp_path: Path):
    truth = np.linspace(1, 4, 64).reshape(8, 8)
    shown: list[np.ndarray | None] = []
    monkeypatch.setattr(grid, "_cell", lambda axis, picture: shown.append(picture))
    photo = np.zeros((8, 8, 3))
    pictures = Pictures(["one"], [photo], [truth], [PictureRow("half", [truth / 2])])
    draw_grid(pictures, tmp_path / "grid.png")
    _, half, same = shown
    limits = depth_limits(truth)
    assert half is not None and np.array_equal(half, depth_colors(truth / 2, *limits))
    assert same is not None and np.array_equal(same, depth_picture(truth))
    assert not np.array_equal(half, same)
