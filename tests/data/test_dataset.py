import importlib

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from mvsam.data.catalog import open_data
from mvsam.data.dataset import TupleDataset, collate, make_targets, make_views
from mvsam.data.readers.posed_folder import PosedFolder
from mvsam.data.transforms import (
    area_resize,
    crop_to_shape,
    resize_intrinsics,
    resize_nearest,
)
from mvsam.types import IGNORE
from tests.synthetic import depth_of, labels_of, write_posed_folder

SIZE = (40, 32)


def test_views_hold_the_resized_frames_reference_first(tmp_path):
    truth = write_posed_folder(tmp_path)
    scene = PosedFolder(tmp_path)
    views = make_views([scene.frame(2), scene.frame(0)], SIZE, (0.2, 4.0))
    assert views.images.shape == (1, 2, 3, 32, 40)
    torch.testing.assert_close(views.images[0, 0], area_resize(truth[2].image, SIZE))
    expected = resize_intrinsics(truth[0].intrinsics, (64, 48), SIZE)
    np.testing.assert_allclose(views.intrinsics[0, 1], expected, rtol=1e-6)
    np.testing.assert_allclose(views.world_from_cam[0, 0], truth[2].world_from_cam, atol=1e-6)
    assert views.depth_range.tolist() == [[pytest.approx(0.2), 4.0]]


def test_measured_depth_is_that_of_the_reference(tmp_path):
    write_posed_folder(tmp_path)
    scene = PosedFolder(tmp_path)
    views = make_views([scene.frame(1), scene.frame(0)], SIZE)
    assert views.measured_depth is not None
    expected = resize_nearest(depth_of(scene.frame(1)), SIZE)
    np.testing.assert_array_equal(views.measured_depth[0], expected)
    write_posed_folder(tmp_path / "bare", depth=False)
    assert make_views([PosedFolder(tmp_path / "bare").frame(0)], SIZE).measured_depth is None


def test_targets_are_read_at_the_nearest_pixel(tmp_path):
    truth = write_posed_folder(tmp_path)
    targets = make_targets(PosedFolder(tmp_path).frame(0), SIZE)
    np.testing.assert_array_equal(targets.labels[0], resize_nearest(truth[0].labels, SIZE))
    np.testing.assert_allclose(targets.depth[0], resize_nearest(truth[0].depth, SIZE), atol=0.51e-3)
    assert targets.labels.dtype == torch.int64


def test_missing_ground_truth_is_unknown_everywhere(tmp_path):
    write_posed_folder(tmp_path, depth=False, labels=False)
    targets = make_targets(PosedFolder(tmp_path).frame(0), SIZE)
    assert targets.depth.shape == targets.labels.shape == (1, 32, 40)
    assert (targets.depth == 0).all()
    assert (targets.labels == IGNORE).all()


def test_a_dataset_lists_every_tuple_of_every_scene(tmp_path):
    for name in "ab":
        write_posed_folder(tmp_path / name, num_frames=3, views=True)
    dataset = TupleDataset([PosedFolder(tmp_path / n) for n in "ab"], num_views=2, size=SIZE)
    assert len(dataset) == 6
    assert [dataset[i][0] for i in range(6)] == list("aaabbb")
    _, views, targets = dataset[4]
    assert views.num_views == 2
    reference = PosedFolder(tmp_path / "b").frame(1)
    np.testing.assert_array_equal(targets.labels[0], resize_nearest(labels_of(reference), SIZE))
    np.testing.assert_allclose(views.world_from_cam[0, 0], reference.world_from_cam, atol=1e-6)


def test_a_dataset_can_keep_a_few_tuples_of_each_scene_evenly_spaced(tmp_path):
    write_posed_folder(tmp_path, num_frames=5, views=True)
    dataset = TupleDataset([PosedFolder(tmp_path)], size=SIZE, tuples_per_scene=3)
    references = [dataset[i][1].world_from_cam[0, 0, 0, 3].item() for i in range(3)]
    assert references == pytest.approx([-0.2, 0.0, 0.2])  # frames 0, 2, 4


def test_skipped_frames_are_listed_with_their_scene(tmp_path):
    write_posed_folder(tmp_path / "room", num_frames=3)
    file = tmp_path / "room/poses/0001.txt"
    np.savetxt(file, np.loadtxt(file) @ np.diag([-1.0, 1, -1, 1]))
    dataset = TupleDataset([PosedFolder(tmp_path / "room")], size=SIZE)
    assert dataset.skipped == ["room: 0001"]
    assert len(dataset) == 2


@pytest.mark.parametrize("depth", [True, False])
def test_collate_stacks_samples_in_order(tmp_path, depth):
    write_posed_folder(tmp_path, num_frames=3, views=True, depth=depth)
    dataset = TupleDataset([PosedFolder(tmp_path)], size=SIZE)
    names, views, targets = next(iter(DataLoader(dataset, batch_size=3, collate_fn=collate)))
    assert names == [tmp_path.name] * 3
    for item in range(3):
        _, one, truth = dataset[item]
        torch.testing.assert_close(views.images[item], one.images[0])
        torch.testing.assert_close(views.intrinsics[item], one.intrinsics[0])
        torch.testing.assert_close(views.world_from_cam[item], one.world_from_cam[0])
        torch.testing.assert_close(targets.depth[item], truth.depth[0])
        torch.testing.assert_close(targets.labels[item], truth.labels[0])
    assert (views.measured_depth is not None) == depth


def test_a_sample_without_measured_depth_takes_that_of_no_other(tmp_path):
    write_posed_folder(tmp_path, num_frames=3, views=True)
    (tmp_path / "depth/0001.png").unlink()
    dataset = TupleDataset([PosedFolder(tmp_path)], size=SIZE)
    _, views, targets = collate([dataset[index] for index in range(3)])
    assert views.measured_depth is not None and (views.measured_depth[1] == 0).all()
    assert torch.equal(views.measured_depth, targets.depth)
    assert (views.measured_depth[[0, 2]] > 0).any(dim=-1).all()


def test_each_procedural_room_is_built_once(monkeypatch):
    module, built = importlib.import_module("mvsam.rooms.scene"), []
    build = module.build_room
    monkeypatch.setattr(module, "build_room", lambda *given: (built.append(1), build(*given))[1])
    rooms = open_data("rooms:val:50-56", room_frames=2, room_size=(32, 32))
    dataset = TupleDataset(rooms, num_views=2, size=(32, 32), tuples_per_scene=1)
    for index in range(len(dataset)):
        dataset[index]
    assert len(built) == len(dataset) == 6


def test_a_dataset_may_crop_and_hand_out_larger_photos(tmp_path):
    write_posed_folder(tmp_path, 2, (64, 48), views=True)
    scene = PosedFolder(tmp_path)
    dataset = TupleDataset([scene], size=SIZE, semantic_size=(64, 48), crop=True)
    _, views, targets = next(iter(DataLoader(dataset, batch_size=2, collate_fn=collate)))
    part = [crop_to_shape(scene.frame(index), SIZE) for index in range(2)]
    expected = make_views(part, SIZE)
    torch.testing.assert_close(views.images[0], expected.images[0])
    torch.testing.assert_close(views.intrinsics[0], expected.intrinsics[0])
    assert torch.equal(targets.labels[:1], make_targets(part[0], SIZE).labels)
    assert views.semantic_images is not None and views.semantic_images.shape == (2, 2, 3, 48, 64)
    torch.testing.assert_close(views.semantic_images[1, 0], area_resize(part[1].image, (64, 48)))
    assert dataset[0][1].to("cpu").semantic_images is not None
