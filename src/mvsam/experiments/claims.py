"""What the paper claims with its tables, and whether the measured rows bear it out."""

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot
from pathlib import Path

from mvsam.experiments.results import Measured, read_measured
from mvsam.experiments.rows import RowRun
from mvsam.experiments.tables import METHODS


@dataclass(frozen=True)
class Claim:
    """One row is better than another; of depth the error is compared, of labels the mIoU."""

    sentence: str
    better: str
    worse: str
    metric: str = "abs"


CLAIMS = (
    Claim("SAM's features lower the depth error", "mvs_sam", "cas_mvsnet"),
    Claim("a U-Net's features lower the depth error", "mvs_unet", "cas_mvsnet"),
    Claim("SAM's features lower it further than a U-Net's", "mvs_sam", "mvs_unet"),
    Claim("training both tasks lowers it again", "base", "mvs_sam"),
    Claim("it does so through SAM->MVS", "base", "base_no_bridge"),
    Claim("the whole network beats its cascade alone", "base", "cas_mvsnet"),
    Claim("five views beat three", "base_5_views", "base"),
    Claim("several views beat one by a wide margin", "base", "mtan"),
    Claim("the whole network labels better than multi-task methods", "base", "mtan", "miou"),
    Claim("the depth prompt raises mIoU", "base", "sam_tuned", "miou"),
    Claim("so it does without SAM->MVS", "base_no_bridge", "sam_tuned", "miou"),
    Claim("the transformer decoder beats the convolutional one", "sam_frozen", "sam_conv", "miou"),
    Claim("tuning the encoder raises mIoU", "sam_tuned", "sam_frozen", "miou"),
    Claim("true depth as prompt is the ceiling", "sam_tuned_gt_depth", "base", "miou"),
)


@dataclass(frozen=True)
class Verdict:
    """What the measured rows say of a claim."""

    claim: Claim
    published: float
    """By how much the better row is better, metres or a fraction of 1."""
    measured: float | None = None
    """None where a row is missing or had too few pictures."""
    spread: float | None = None
    """Standard deviation of that difference between two single runs, a row with one seed taken to
    scatter as the other does; None where both have one."""
    single: tuple[str, ...] = ()
    """Rows with one seed."""
    obstacle: str = ""
    """Why there is no verdict."""

    @property
    def text(self) -> str:
        """A gain counts from one spread on, where a row has one seed from two."""
        if self.measured is None:
            return self.obstacle
        enough = (self.spread or 0.0) * (2 if self.single else 1)
        if abs(self.measured) <= enough:
            alone = f", with one seed of {' and '.join(self.single)}" if self.single else ""
            return f"undecided: within the spread of the seeds{alone}"
        verdict = "holds" if self.measured > 0 else "does not hold"
        if not self.single:
            return verdict
        return f"{verdict}, with one seed of {' and '.join(self.single)}"


def judge(claim: Claim, runs: dict[str, RowRun], folder: Path) -> Verdict:
    """The verdict of the results in a folder."""
    published = published_gain(claim)
    measured: list[Measured] = []
    for name in (claim.better, claim.worse):
        row = read_measured(folder, runs[name])
        if row is None:
            return Verdict(claim, published, obstacle=f"open: {name} is missing")
        if row.pictures < runs[name].enough:
            return Verdict(claim, published, obstacle=f"open: {name} had too few pictures")
        measured.append(row)
    if len({row.pictures for row in measured}) > 1:
        return Verdict(claim, published, obstacle="open: they saw different numbers of pictures")
    if _differ_in_package_weights(row.weights for row in measured):
        return Verdict(claim, published, obstacle="open: they began with different weights")
    means = [row.means[claim.metric] for row in measured]
    deviations = [row.deviations[claim.metric] for row in measured]
    known = [deviation for deviation in deviations if deviation is not None]
    better, worse = means
    assert better is not None and worse is not None, "claims are about tasks that both rows have"
    return Verdict(
        claim,
        published,
        _gain(claim, better, worse),
        spread=hypot(known[0], known[-1]) if known else None,
        single=tuple(
            name
            for name, deviation in zip((claim.better, claim.worse), deviations, strict=True)
            if deviation is None
        ),
    )


def _differ_in_package_weights(beginnings: Iterable[str]) -> bool:
    """Whether rows began with two versions of a file that comes with the package."""
    hashes: defaultdict[str, set[str]] = defaultdict(set)
    for began_with in beginnings:
        for name, digest in re.findall(r"\b(tiny|rows_encoder) ([0-9a-f]{8})\b", began_with):
            hashes[name].add(digest)
    return any(len(found) > 1 for found in hashes.values())


def published_gain(claim: Claim) -> float:
    """By how much the paper's better row is better, metres or a fraction of 1."""
    better, worse = METHODS[claim.better], METHODS[claim.worse]
    return _gain(claim, better.published[claim.metric], worse.published[claim.metric])


def _gain(claim: Claim, better: float, worse: float) -> float:
    return better - worse if claim.metric == "miou" else worse - better
