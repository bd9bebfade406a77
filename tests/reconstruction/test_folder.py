import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mvsam.data.labels import SCANNET20
from mvsam.errors import InputError
from mvsam.reconstruction.cloud import build_cloud
from mvsam.reconstruction.filtering import back_project
from mvsam.reconstruction.folder import read_predictions
from mvsam.reconstruction.settings import CloudSettings
from tests.reconstruction.test_filtering import distance_to_walls


def test_true_depths_rebuild_the_room(folder: Path):
    settings = CloudSettings(voxel_size=0.05)
    cloud = build_cloud(read_predictions(folder), settings)
    assert len(cloud) > 2000
    # A mean over a voxel at an edge of the room cuts the corner; a millimetre is the PNG's step.
    assert distance_to_walls(cloud.points).max() < settings.voxel_size
    assert np.quantile(distance_to_walls(cloud.points), 0.9) < 2e-3


def test_a_wrong_photo_is_filtered_out(folder: Path):
    views = read_predictions(folder)

    with Image.open(views[1].depth_path) as picture:
        depth = np.array(picture)
    Image.fromarray((depth * 0.7).astype(np.uint16)).save(views[1].depth_path)
    shares: dict[str, float] = {}
    cloud = build_cloud(views, CloudSettings(voxel_size=0.05), shares.__setitem__)
    assert distance_to_walls(cloud.points).max() < 0.05
    wrong = views[1].photo_path.stem
    assert len(shares) == len(views) and shares[wrong] < 0.1
    assert all(share > 0.5 for name, share in shares.items() if name != wrong)
    unfiltered = CloudSettings(voxel_size=0.05, minimum_consistent_views=0)
    assert distance_to_walls(build_cloud(views, unfiltered).points).max() > 0.3


@pytest.mark.parametrize("longest_side", [128, 64, 43])
def test_thinned_maps_keep_their_geometry(folder: Path, longest_side: int):
    view = read_predictions(folder, longest_side)[2]
    depth = view.depth()
    assert max(depth.shape) <= longest_side
    assert view.size == depth.shape[::-1]
    assert view.photo().shape == (*depth.shape, 3)
    assert view.labels().shape == view.confidence().shape == depth.shape
    assert distance_to_walls(back_project(view, depth)).max() < 2e-3


def test_the_label_pictures_bring_their_colours(folder: Path):
    palette = read_predictions(folder)[0].palette()
    np.testing.assert_array_equal(palette[: len(SCANNET20)], SCANNET20.colors)


def test_too_strict_filters_are_named(folder: Path):
    with pytest.raises(InputError, match="no depth passed the filters"):
        build_cloud(read_predictions(folder), CloudSettings(minimum_confidence=0.99))


def test_a_folder_that_is_not_from_predict_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match=r"no transforms\.json"):
        read_predictions(tmp_path)


def test_a_damaged_index_and_a_missing_map_are_named(folder: Path):
    (folder / "depth/0001.png").unlink()
    with pytest.raises(InputError, match=r"0001\.png cannot be read"):
        build_cloud(read_predictions(folder), CloudSettings())
    (folder / "transforms.json").write_text("{")
    with pytest.raises(InputError, match=r"transforms\.json is damaged"):
        read_predictions(folder)


def test_predictions_without_depth_cannot_be_fused(folder: Path):
    index = json.loads((folder / "transforms.json").read_text())
    for frame in index["frames"]:
        del frame["depth_file_path"]
    (folder / "transforms.json").write_text(json.dumps(index))
    with pytest.raises(InputError, match="holds no depth maps"):
        read_predictions(folder)
