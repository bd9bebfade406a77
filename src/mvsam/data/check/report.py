"""What a scene holds, in numbers that show what is wrong with it before an hour is spent on it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mvsam.data.about import About
from mvsam.data.check.depth import Verdict
from mvsam.data.check.evidence import Evidence
from mvsam.data.check.features import Features, features_of
from mvsam.data.depth_range import DepthRange
from mvsam.types import IGNORE, Frame, Scene

SAMPLED_FRAMES = 50
"""Evenly spaced frames whose photo, depth and labels are read."""


@dataclass(frozen=True)
class SceneReport:
    """`mvsam data check`, as a record."""

    name: str
    num_frames: int
    has_unit: bool
    """Whether the poses are in metres; those of a COLMAP model are in a unit of its own."""
    num_lost: int
    """Pictures that have no pose, because tracking was lost, say; they are left out."""
    sizes: list[tuple[int, int]]
    """(width, height) of the photos, each that occurs."""
    baselines: list[float]
    """Metres, or units, to the nearest other camera: least, median, most."""
    turns: list[float]
    """Degrees between the optical axes of those two: least, median, most."""
    num_depth: int
    """Frames with measured depth."""
    depth_coverage: float | None
    """Share of pixels with a depth, 0..1; None without depth."""
    depths: list[float]
    """1st, 50th and 99th percentile, metres; empty without depth."""
    num_labels: int
    label_shares: dict[str, float]
    """Of the pixels of frames with labels, by class name, and "unlabelled"."""
    photo_hint: str | None
    """What the photos and viewing frusta say against the poses; None: nothing, or they were not
    asked, which takes ten times as long, because the depth can tell."""
    depth_verdict: Verdict
    """What the depth says about the cameras."""
    features: Features
    """How precise the cameras are; those that fit the depth may yet be a little off."""

    @property
    def evidence(self) -> Evidence:
        """Against all cameras together; single ones are told by `features`."""
        return Evidence(self.num_frames, self.depth_verdict, self.photo_hint)

    @property
    def is_suspicious(self) -> bool:
        """Whether cameras seem wrong."""
        return self.verdict == "wrong"

    @property
    def verdict(self) -> Literal["wrong", "imprecise", "fits", "unknown"]:
        """What is to be made of it all; "unknown": nothing speaks for or against the cameras."""
        if self.evidence.is_suspicious or self.features.are_wrong:
            return "wrong"
        if self.features.are_off:
            return "imprecise"
        by_features = bool(self.features.distances) and not self.depth_verdict.agreement
        return "fits" if self.depth_verdict.fits or by_features else "unknown"


def report_scene(scene: Scene, depth_range: DepthRange = (0.1, 5.0)) -> SceneReport:
    """Looks at every camera and at the pixels of at most 50 frames."""
    frames = [scene.frame(index) for index in range(len(scene))]
    sampled = frames[:: -(-len(frames) // SAMPLED_FRAMES)]
    for frame in sampled:
        _ = frame.image  # a damaged photo is named here, not after an hour
    baselines, turns = _neighbours(frames)
    coverage, depths = _depth_statistics(sampled)
    evidence, about = Evidence.of(frames, depth_range), About.of(scene)
    return SceneReport(
        name=scene.name,
        num_frames=len(frames),
        has_unit=about.has_unit,
        num_lost=about.num_lost,
        sizes=sorted({frame.size for frame in frames}),
        baselines=baselines,
        turns=turns,
        num_depth=sum(frame.load_depth is not None for frame in frames),
        depth_coverage=coverage,
        depths=depths,
        num_labels=sum(frame.load_labels is not None for frame in frames),
        label_shares=_label_shares(sampled, about.classes.names),
        photo_hint=evidence.photos,
        depth_verdict=evidence.depth,
        features=features_of(scene, depth_range),
    )


def _neighbours(frames: Sequence[Frame]) -> tuple[list[float], list[float]]:
    if len(frames) < 2:
        return [], []
    poses = np.stack([frame.world_from_cam for frame in frames])
    distances, turns = [], []
    for index, pose in enumerate(poses):  # a row at a time: scans have thousands of frames
        distance = np.linalg.norm(poses[:, :3, 3] - pose[:3, 3], axis=1)
        distance[index] = np.inf
        nearest = int(distance.argmin())
        distances.append(distance[nearest])
        here, there = pose[:3, 2], poses[nearest, :3, 2]
        turns.append(np.degrees(np.arctan2(np.linalg.norm(np.cross(here, there)), here @ there)))
    return _spread(distances, (0, 50, 100)), _spread(turns, (0, 50, 100))


def _depth_statistics(frames: Sequence[Frame]) -> tuple[float | None, list[float]]:
    maps = [depth[::4, ::4].ravel() for frame in frames if (depth := frame.depth) is not None]
    if not maps:
        return None, []
    values = np.concatenate(maps)
    known = values[values > 0]
    return float((values > 0).mean()), _spread(known, (1, 50, 99)) if len(known) else []


def _label_shares(frames: Sequence[Frame], names: Sequence[str]) -> dict[str, float]:
    counts = np.zeros(256, dtype=np.int64)
    for frame in frames:
        if (labels := frame.labels) is not None:
            counts += np.bincount(labels.ravel(), minlength=256)
    if not counts.any():
        return {}
    shares = counts / counts.sum()
    return {name: float(shares[i]) for i, name in enumerate(names) if counts[i]} | {
        "unlabelled": float(shares[IGNORE])
    }


def _spread(values, percentiles: tuple[int, ...]) -> list[float]:
    return [float(value) for value in np.percentile(values, percentiles)]
