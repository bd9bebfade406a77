"""An endless stream of training samples in which sample n depends on (seed, n) alone."""

from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from torch.utils.data import Dataset, Sampler

from mvsam.data.catalog import is_rooms, open_data
from mvsam.data.dataset import collate, make_targets, make_views
from mvsam.data.lazy import changed
from mvsam.data.readers.single_views import SingleViews
from mvsam.data.sampling import view_tuples
from mvsam.data.streaming.augment import (
    as_if_estimated,
    jitter_colors,
    mirrored,
    random_part,
    with_pose_noise,
)
from mvsam.data.streaming.config import DataConfig
from mvsam.data.streaming.mixture import Mixture, parse_sources
from mvsam.data.streaming.name_lists import read_names
from mvsam.data.streaming.shards import ShardedScene
from mvsam.data.transforms import crop_to_shape
from mvsam.data.view_rules import prescribe
from mvsam.errors import InputError
from mvsam.types import Scene, Targets, Views


class TrainingSample(NamedTuple):
    """A batch of one of `train`, or of several."""

    views: Views
    targets: list[Targets]
    """Of view 0, 1, ... as reference."""
    singles: tuple[Views, Targets] | None = None
    """Labelled photos that belong to no tuple, `singles_per_sample` for each item of `views`; one
    view each, with its measured depth."""


class SampleStream(Dataset[TrainingSample]):
    """Sample n: the next scene of its source in endlessly reshuffled order, a random tuple of it.

    batch_size: of so many samples in a row all have equally many views, as a step's must.
    """

    def __init__(self, config: DataConfig, seed: int, batch_size: int = 1):
        self.config, self.seed, self.batch_size = config, seed, batch_size
        sources = parse_sources(config.train)
        self.sources = [_open_source(source.name, config) for source in sources]
        self._mixture = Mixture([source.weight for source in sources], seed)
        self._singles = None if config.singles is None else SingleStream(config, seed)
        self._tuples: dict[tuple[int, int], list[tuple[int, ...]]] = {}

    def __getitem__(self, n: int) -> TrainingSample:
        source, place = self._mixture(n)
        scenes = self.sources[source]
        epoch, position = divmod(place, len(scenes))
        index = int(_permutation(self.seed, epoch, len(scenes))[position])
        scene, config = scenes[index], self.config
        tuples = self._full_tuples((source, index), scene)
        dice = np.random.default_rng((self.seed, n))
        chosen = tuples[dice.integers(len(tuples))][: self._num_views(n)]
        frames = [scene.frame(index) for index in chosen]
        if config.crop:
            frames = [crop_to_shape(frame, config.size) for frame in frames]
        if config.views_part < 1 and dice.random() < 0.5:
            frames = [random_part(frame, config.views_part, dice) for frame in frames]
        if config.mirror and dice.random() < 0.5:
            frames = [mirrored(frame) for frame in frames]
        if any(config.pose_noise):
            metres, degrees = _drawn_pose_noise(config, dice)
            frames = [with_pose_noise(frame, metres, degrees, dice) for frame in frames]
        depth_range = _drawn_range(config, dice)
        views = make_views(frames, config.size, depth_range, config.semantic_size)
        if config.color_jitter:
            views = _recoloured(views, config.color_jitter, dice)
        views = _prompted(views, config.prompt_noise, dice)
        targets = [make_targets(frame, config.size) for frame in frames[: config.references]]
        singles = None if self._singles is None else self._singles[n]
        return TrainingSample(views, targets, singles)

    def _num_views(self, n: int) -> int:
        if self.config.fewest_views is None:
            return self.config.num_views
        dice = np.random.default_rng((self.seed, n // self.batch_size, 3))
        return int(dice.integers(self.config.fewest_views, self.config.num_views + 1))

    def _full_tuples(self, key: tuple[int, int], scene: Scene) -> list[tuple[int, ...]]:
        """Those with as many views as are asked for, so that samples fit into one batch."""
        if key not in self._tuples:
            tuples, _ = view_tuples(scene, self.config.num_views, self.config.depth_range)
            full = [views for views in tuples if len(views) == self.config.num_views]
            if not full:
                raise InputError(
                    f"{scene.name}: no photo has {self.config.num_views - 1} sources that overlap "
                    "it; leave the scene out or train with fewer --data.num-views."
                )
            self._tuples[key] = full
        return self._tuples[key]


def _open_source(name: str, config: DataConfig) -> Sequence[Scene]:
    """The scenes of one source; scans with the tuples of `config.tuples`, kept as shards."""
    size = config.semantic_size or config.size
    scenes = open_data(
        name,
        room_frames=config.room_frames,
        room_size=size,
        cache=config.cache,
        assets=config.assets,
        **config.of_scans(name),
    )
    if is_rooms(name):
        return scenes
    if config.tuples is not None:
        scenes = _with_tuples(scenes, config.tuples, name, config)
    if config.cache is None:
        return scenes
    width, height = size
    folder = Path(config.cache) / f"scans-{width}x{height}"
    return changed(scenes, partial(ShardedScene, folder=folder, size=size, crop=config.crop))


def _with_tuples(
    scenes: Sequence[Scene], rule: str, name: str, config: DataConfig
) -> Sequence[Scene]:
    """The scenes under the one rule of all sources; InputError where the first cannot follow it."""
    try:
        scenes = prescribe(scenes, rule, config.num_views, config.depth_range)
        _ = scenes[0]
    except InputError as error:
        raise InputError(
            f"--data.tuples {rule} is for every recorded source of --data.train, but {name} cannot "
            f"follow it: {error} Or leave the option out, and write views.txt into the scenes that "
            "need a rule (mvsam data scannet --tuples)."
        ) from error
    return scenes


class SingleStream(Dataset[tuple[Views, Targets]]):
    """Item n: the labelled photos of sample n, in endlessly reshuffled order, parts of them."""

    def __init__(self, config: DataConfig, seed: int):
        assert config.singles is not None
        self.config, self.seed = config, seed
        without = [name for names in config.singles_without for name in read_names(names)]
        self.photos = SingleViews(Path(config.singles), without)

    def __getitem__(self, n: int) -> tuple[Views, Targets]:
        count = self.config.singles_per_sample
        places = range(n * count, (n + 1) * count)
        return collate([("", *self._photo(place)) for place in places])[1:]

    def _photo(self, place: int) -> tuple[Views, Targets]:
        epoch, position = divmod(place, len(self.photos))
        index = int(_permutation(self.seed, epoch, len(self.photos))[position])
        frame = self.photos[index].frame(0)
        config, dice = self.config, np.random.default_rng((self.seed, place, 2))
        frame = random_part(frame, config.singles_part, dice)
        if config.mirror and dice.random() < 0.5:
            frame = mirrored(frame)
        depth_range = _drawn_range(config, dice)
        views = make_views([frame], config.size, depth_range, config.semantic_size)
        if config.color_jitter:
            views = _recoloured(views, config.color_jitter, dice)
        targets = make_targets(frame, config.size)
        views = replace(views, measured_depth=targets.depth)  # 0 = unknown, not None
        return _prompted(views, config.prompt_noise, dice), targets


def _drawn_pose_noise(config: DataConfig, dice: np.random.Generator) -> tuple[float, float]:
    """(metres, degrees)."""
    least = config.least_pose_noise_share
    share = least if least == 1 else dice.uniform(least, 1)
    return share * config.pose_noise[0], share * config.pose_noise[1]


def _drawn_range(config: DataConfig, dice: np.random.Generator) -> tuple[float, float]:
    if config.farthest is None:
        return config.depth_range
    return config.depth_range[0], float(np.exp(dice.uniform(*np.log(config.farthest))))


def _prompted(views: Views, noise: float, dice: np.random.Generator) -> Views:
    """Half of the time with a measured depth that is as wrong as an estimated one."""
    if not noise or views.measured_depth is None or dice.random() >= 0.5:
        return views
    estimated = as_if_estimated(views.measured_depth, noise, dice)
    return replace(views, measured_depth=estimated)


def _recoloured(views: Views, strength: float, dice: np.random.Generator) -> Views:
    """The same new colours for both sizes of the pictures."""
    images, semantic, again = views.images[0], views.semantic_images, deepcopy(dice)
    if semantic is not None:
        semantic = jitter_colors(semantic[0], strength, again)[None]
    images = jitter_colors(images, strength, dice)[None]
    return replace(views, images=images, semantic_images=semantic)


@lru_cache(maxsize=4)
def _permutation(seed: int, epoch: int, count: int) -> np.ndarray:
    return np.random.default_rng((seed, epoch, 1)).permutation(count)


class Onward(Sampler[int]):
    """`first`, `first` + stride, ... without end: one process's share of the sample numbers.

    first: this process's next sample. stride: how many processes share the stream.
    """

    def __init__(self, first: int, stride: int = 1):
        self.first, self.stride = first, stride

    def __iter__(self) -> Iterator[int]:
        n = self.first
        while True:
            yield n
            n += self.stride


def collate_training(samples: Sequence[TrainingSample]) -> TrainingSample:
    """One batch from samples of equal size."""
    views = collate([("", sample.views, sample.targets[0]) for sample in samples])[1]
    targets = [
        collate([("", sample.views, sample.targets[reference]) for sample in samples])[2]
        for reference in range(len(samples[0].targets))
    ]
    singles = [("", *sample.singles) for sample in samples if sample.singles is not None]
    return TrainingSample(views, targets, collate(singles)[1:] if singles else None)
