"""Sample n of a run is a function of (seed, n) alone."""

from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from mvsam.data.dataset import make_views
from mvsam.data.readers.single_views import SingleViews
from mvsam.data.streaming.config import DataConfig
from mvsam.data.streaming.stream import (
    Onward,
    SampleStream,
    TrainingSample,
    collate_training,
)
from mvsam.errors import InputError
from mvsam.types import Targets, Views
from tests.synthetic import write_posed_folder


@pytest.fixture(scope="module")
def config(tmp_path_factory) -> DataConfig:
    """Three scenes of four frames."""
    folder = tmp_path_factory.mktemp("scenes")
    for index in range(3):
        write_posed_folder(folder / f"room{index}", 4, (32, 32), baseline=0.08 + 0.02 * index)
    return DataConfig(train=str(folder), size=(32, 32), references=2)


def fingerprint(sample: TrainingSample) -> torch.Tensor:
    views, targets, singles = sample
    assert singles is None
    parts = [views.images, views.intrinsics, views.world_from_cam, *(t.depth for t in targets)]
    return torch.cat([part.flatten() for part in [*parts, *(t.labels for t in targets)]])


def assert_equal(first: TrainingSample, second: TrainingSample) -> None:
    assert torch.equal(fingerprint(first), fingerprint(second))


def test_a_source_that_cannot_follow_the_rule_of_all_is_named(tmp_path):
    for name in ("room", "other"):
        write_posed_folder(tmp_path / name)
    (tmp_path / "split.txt").write_text("room 0 1 2\n")
    both = f"{tmp_path}/room + {tmp_path}/other"
    for rule, culprit in [("mvs2d", "room"), (f"{tmp_path}/split.txt", "other")]:
        with pytest.raises(InputError, match=rf"/{culprit} cannot follow it: .* write views\.txt"):
            SampleStream(DataConfig(both, tuples=rule), seed=0)


def test_a_sample_does_not_depend_on_those_read_before(config: DataConfig):
    forward, backward = SampleStream(config, seed=1), SampleStream(config, seed=1)
    samples = {n: forward[n] for n in range(6)}
    for n in (5, 2, 0):
        assert_equal(backward[n], samples[n])


def test_another_seed_gives_other_samples(config: DataConfig):
    prints = [
        torch.stack([fingerprint(SampleStream(config, seed)[n]) for n in range(6)])
        for seed in (1, 2)
    ]
    assert not torch.equal(*prints)


def scene_of(sample: TrainingSample, stream: SampleStream) -> int:
    """The scene that has all cameras of the sample."""
    for index, scene in enumerate(stream.sources[0]):
        own = [scene.frame(i).world_from_cam for i in range(len(scene))]
        poses = sample[0].world_from_cam[0].numpy()
        if all(any(np.allclose(pose, frame, atol=1e-6) for frame in own) for pose in poses):
            return index
    raise AssertionError("no scene has these cameras")


def test_each_scene_comes_once_in_every_epoch_in_changing_order(config: DataConfig):
    stream = SampleStream(config, seed=1)
    order = [scene_of(stream[n], stream) for n in range(15)]
    epochs = [tuple(order[3 * epoch : 3 * epoch + 3]) for epoch in range(5)]
    assert all(sorted(epoch) == [0, 1, 2] for epoch in epochs)
    assert len(set(epochs)) > 1


def test_a_scene_shows_other_tuples_when_it_comes_again(config: DataConfig):
    stream = SampleStream(config, seed=1)
    poses = [stream[n][0].world_from_cam for n in range(24) if scene_of(stream[n], stream) == 0]
    assert len({str(pose.tolist()) for pose in poses}) > 1


def test_samples_hold_the_references_first_and_their_own_targets(config: DataConfig):
    views, targets, _ = SampleStream(config, seed=1)[0]
    assert views.images.shape == (1, 3, 3, 32, 32) and len(targets) == 2
    assert views.with_reference(1).measured_depth is None  # it is the first reference's
    one = SampleStream(replace(config, references=1), seed=1)[0]
    assert one[0].measured_depth is not None
    assert torch.equal(one[0].measured_depth, one[1][0].depth)
    assert torch.equal(one[1][0].depth, targets[0].depth)


def test_a_worker_process_reads_the_same_samples(config: DataConfig):
    def first(count: int, workers: int) -> list[TrainingSample]:
        loader = DataLoader(
            SampleStream(config, seed=1),
            batch_size=2,
            sampler=Onward(1),
            num_workers=workers,
            collate_fn=collate_training,
            multiprocessing_context="spawn" if workers else None,
        )
        return list(islice(iter(loader), count))

    for here, there in zip(first(2, workers=0), first(2, workers=1), strict=True):
        assert_equal(here, there)


def test_frames_kept_at_the_training_size_give_the_same_samples(config: DataConfig, tmp_path: Path):
    whole, kept = config, replace(config, cache=str(tmp_path))
    for n in (3, 0):
        assert_equal(SampleStream(kept, seed=1)[n], SampleStream(whole, seed=1)[n])
    assert list(tmp_path.glob("scans-32x32/room*/0000.npz"))


def test_sources_mix_in_their_shares(config: DataConfig, tmp_path: Path):
    write_posed_folder(tmp_path / "other", 4, (32, 32), baseline=0.2)
    both = replace(config, train=f"3 @ {config.train} + 1 @ {tmp_path / 'other'}")
    stream = SampleStream(both, seed=1)
    other = np.stack([stream.sources[1][0].frame(i).world_from_cam[:3, 3] for i in (1, 2, 3)])
    centres = [stream[n].views.world_from_cam[0, :, :3, 3].numpy() for n in range(100)]
    far = [(abs(c[:, None] - other).sum(-1) < 1e-5).any() for c in centres]
    assert sum(far) == 25


def test_scans_have_a_scale_and_a_format(config: DataConfig):
    doubled, given = SampleStream(replace(config, scale="2"), seed=1), SampleStream(config, seed=1)
    poses = [stream.sources[0][0].frame(1).world_from_cam for stream in (doubled, given)]
    np.testing.assert_allclose(poses[0][:3, 3], 2 * poses[1][:3, 3])
    with pytest.raises(InputError, match="format"):
        SampleStream(replace(config, format="colma"), seed=1)
    both = replace(config, train=f"rooms:train:0-2 + {config.train}", scale="2")
    assert len(SampleStream(both, seed=1).sources) == 2


@pytest.mark.parametrize("scale", ["0.31", "0000:0001=0.25"])
def test_a_scale_for_several_recorded_sources_is_refused(config: DataConfig, tmp_path, scale):
    write_posed_folder(tmp_path / "other", 4, (32, 32))
    both = replace(config, train=f"0.5 @ {config.train} + 0.5 @ {tmp_path / 'other'}")
    with pytest.raises(InputError, match=r"--data\.scale .* has 2; convert .* data convert SCENE"):
        SampleStream(replace(both, scale=scale), seed=1)
    assert len(SampleStream(replace(both, scale="1.0"), seed=1).sources) == 2


def test_scans_are_seen_by_a_rule(tmp_path: Path):
    write_posed_folder(tmp_path / "scan", 61, (32, 32), baseline=0.01)
    config = DataConfig(train=str(tmp_path / "scan"), size=(32, 32), tuples="mvs2d")
    (scene,) = SampleStream(config, seed=1).sources[0]
    assert scene.views() == [(0, 20, 40), (20, 0, 40), (40, 20, 60), (60, 40, 20)]


@pytest.mark.parametrize("processes", [1, 2, 4])
def test_processes_share_the_numbers_of_one_step(processes: int):
    batch, step = 8, 3
    share = batch // processes
    numbers = [
        list(islice(Onward(step * batch + rank, processes), share)) for rank in range(processes)
    ]
    assert sorted(chain.from_iterable(numbers)) == list(range(step * batch, (step + 1) * batch))


def test_collating_stacks_samples_and_keeps_references_apart(config: DataConfig):
    stream = SampleStream(config, seed=1)
    views, targets, _ = collate_training([stream[0], stream[1]])
    assert views.images.shape == (2, 3, 3, 32, 32) and len(targets) == 2
    for reference in range(2):
        for item in range(2):
            expected = stream[item][1][reference].depth[0]
            assert torch.equal(targets[reference].depth[item], expected)


def test_photos_for_sam_are_recoloured_and_cropped_as_the_pictures_are(config: DataConfig):
    config = replace(config, size=(32, 16), semantic_size=(32, 16), color_jitter=0.2, crop=True)
    views, *_ = SampleStream(config, seed=1)[0]
    assert views.semantic_images is not None
    torch.testing.assert_close(views.semantic_images, views.images)
    larger, *_ = SampleStream(replace(config, semantic_size=(64, 48)), seed=1)[0]
    assert torch.equal(larger.images, views.images)


def test_prompts_are_wrong_in_half_of_the_samples_and_targets_in_none(config: DataConfig):
    config = replace(config, num_views=1, references=1)
    right, wrong = (
        SampleStream(replace(config, prompt_noise=noise), seed=1) for noise in (0.0, 0.1)
    )
    changed = 0
    for n in range(24):
        one, other = right[n], wrong[n]
        assert torch.equal(one.targets[0].depth, other.targets[0].depth)
        assert one.views.measured_depth is not None and other.views.measured_depth is not None
        changed += not torch.equal(one.views.measured_depth, other.views.measured_depth)
    assert 5 <= changed <= 19


@pytest.fixture(scope="module")
def mixed(config: DataConfig, tmp_path_factory) -> DataConfig:
    """The same scenes with two of four labelled photos beside each sample."""
    folder = tmp_path_factory.mktemp("singles")
    write_posed_folder(folder, 5, (40, 30))
    (folder / "without.txt").write_text("0001\n")
    return replace(
        config,
        singles=str(folder),
        singles_per_sample=2,
        singles_without=(str(folder / "without.txt"),),
        mirror=True,
        color_jitter=0.1,
    )


def singles_of(sample: TrainingSample) -> tuple[Views, Targets]:
    assert sample.singles is not None
    return sample.singles


def test_labelled_photos_come_beside_each_sample_with_their_own_depth(mixed: DataConfig):
    views, targets = singles_of(SampleStream(mixed, seed=1)[0])
    assert views.images.shape == (2, 1, 3, 32, 32) and targets.labels.shape == (2, 32, 32)
    assert views.measured_depth is not None
    assert torch.equal(views.measured_depth, targets.depth)
    batch = collate_training([SampleStream(mixed, seed=1)[n] for n in range(3)])
    assert singles_of(batch)[0].images.shape == (6, 1, 3, 32, 32)


def test_prompts_of_labelled_photos_are_wrong_in_half_of_them_and_targets_in_none(
    mixed: DataConfig,
):
    stream = SampleStream(replace(mixed, prompt_noise=0.1), seed=1)
    right, changed = SampleStream(mixed, seed=1), []
    for n in range(12):
        (views, targets), (_, expected) = singles_of(stream[n]), singles_of(right[n])
        assert views.measured_depth is not None
        assert torch.equal(targets.depth, expected.depth)
        changed += [
            not torch.equal(a, b) for a, b in zip(views.measured_depth, targets.depth, strict=True)
        ]
    assert len(changed) == 24 and 5 <= sum(changed) <= 19


def test_a_labelled_photo_without_depth_leaves_the_others_theirs(mixed: DataConfig, tmp_path: Path):
    write_posed_folder(tmp_path, 2, (40, 30))
    (tmp_path / "depth/0000.png").unlink()
    config = replace(mixed, singles=str(tmp_path), singles_without=())
    views, targets = singles_of(SampleStream(config, seed=1)[0])
    assert views.measured_depth is not None
    assert sorted((views.measured_depth > 0).flatten(1).any(dim=1).tolist()) == [False, True]
    assert torch.equal(views.measured_depth, targets.depth)
    alone = singles_of(SampleStream(replace(config, singles_per_sample=1), seed=1)[0])
    assert alone[0].measured_depth is not None


def test_labelled_photos_depend_on_seed_and_number_alone_and_change_no_tuple(mixed: DataConfig):
    forward, backward = SampleStream(mixed, seed=1), SampleStream(mixed, seed=1)
    samples = {n: forward[n] for n in range(4)}
    other = SampleStream(replace(mixed, singles=None), seed=1)
    for n in (3, 0, 2):
        first, second = singles_of(samples[n])[0], singles_of(backward[n])[0]
        assert torch.equal(first.images, second.images)
        assert_equal(samples[n]._replace(singles=None), other[n])


def test_each_labelled_photo_comes_once_an_epoch_and_those_left_out_never(mixed: DataConfig):
    stream = SampleStream(replace(mixed, singles_part=1.0, mirror=False, color_jitter=0.0), seed=1)
    frames = [scene.frame(0) for scene in SingleViews(Path(str(mixed.singles)))]
    shown = [image[0] for n in range(2) for image in singles_of(stream[n])[0].images]
    names = [
        frame.name
        for frame in frames
        for image in shown
        if torch.equal(make_views([frame], (32, 32)).images[0, 0], image)
    ]
    assert names == ["0000", "0002", "0003", "0004"]


def test_the_number_of_views_changes_from_step_to_step_and_not_within_one(config: DataConfig):
    stream = SampleStream(replace(config, fewest_views=2), seed=1, batch_size=2)
    counts = [stream[n].views.num_views for n in range(16)]
    assert counts[::2] == counts[1::2] and set(counts) == {2, 3}
    whole = SampleStream(config, seed=1)
    shorter = counts.index(2)
    assert torch.equal(stream[shorter].views.images, whole[shorter].views.images[:, :2])


def test_the_end_of_the_depth_range_is_drawn_for_each_sample(config: DataConfig):
    stream = SampleStream(replace(config, farthest=(3.0, 12.0)), seed=1)
    ends = [stream[n].views.depth_range[0].tolist() for n in range(12)]
    assert all(near == pytest.approx(0.1) and 3 <= far <= 12 for near, far in ends)
    assert max(far for _, far in ends) > 2 * min(far for _, far in ends)


def test_pose_noise_moves_every_view_and_no_depth(config: DataConfig):
    clean = SampleStream(config, seed=1)[0]
    noisy = SampleStream(replace(config, pose_noise=(0.005, 0.2)), seed=1)[0]
    moved = noisy.views.world_from_cam - clean.views.world_from_cam
    assert (moved[0, :, :3, 3].norm(dim=-1) > 1e-4).all() and moved.abs().max() < 0.05
    assert torch.equal(noisy.targets[0].depth, clean.targets[0].depth)


def test_samples_have_shares_of_the_pose_noise(config: DataConfig):
    clean = SampleStream(config, seed=1)
    noisy = SampleStream(
        replace(config, pose_noise=(0.01, 0.0), least_pose_noise_share=0.0), seed=1
    )
    off = [
        (noisy[n].views.world_from_cam - clean[n].views.world_from_cam)[..., :3, 3].std().item()
        for n in range(8)
    ]
    assert min(off) < 0.003 and 0.006 < max(off) < 0.02


def test_half_of_the_samples_are_parts_of_their_photos(config: DataConfig):
    stream = SampleStream(replace(config, views_part=0.5), seed=1)
    whole = SampleStream(config, seed=1)[0].views.intrinsics[0, 0, 0, 0].item()
    lenses = [stream[n].views.intrinsics[0, :, 0, 0] / whole for n in range(40)]
    assert all(((lens >= 1) & (lens <= 2.1)).all() for lens in lenses)
    parts = [lens for lens in lenses if (lens > 1).any()]
    assert 10 < len(parts) < 30, "half of them, by chance"
    assert all(len(set(lens.tolist())) > 1 for lens in parts), "each view has a part of its own"
