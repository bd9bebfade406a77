"""Poses with time stamps in text files: TUM's lines, and those of ARKit's recorders."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mvsam.errors import InputError
from mvsam.geometry.pose import pose_from_quaternion

_LARGEST = 1e9
"""Of a believable number; squares of larger ones may overflow."""

PoseOf = Callable[[Float[np.ndarray, " value"]], Float[np.ndarray, "4 4"]]
"""What the numbers behind a time stamp mean; ValueError where they mean nothing."""


@dataclass(frozen=True)
class Trajectory:
    """Poses in the order of time."""

    times: Float[np.ndarray, " pose"]
    """Seconds."""
    poses: list[Float[np.ndarray, "4 4"]]

    def at(self, time: float, longest_gap: float) -> Float[np.ndarray, "4 4"] | None:
        """The pose nearest in time, or None where none is within `longest_gap` seconds."""
        index = nearest_in_time(self.times, time, longest_gap)
        return None if index is None else self.poses[index]


def nearest_in_time(
    times: Float[np.ndarray, " stamp"], time: float, longest_gap: float
) -> int | None:
    """The stamp nearest in time, or None beyond `longest_gap`, all in seconds."""
    if not len(times):
        return None
    index = int(np.abs(times - time).argmin())
    return index if abs(times[index] - time) <= longest_gap else None


def read_trajectory(file: Path, count: int, pose_of: PoseOf, expected: str) -> Trajectory:
    """The trajectory of a text file with a time stamp and `count` numbers a line.

    expected: what the error says a line should hold.
    """
    times, poses = [], []
    for number, words in text_lines(file):
        try:
            time, values = time_stamp(words[0]), [float(word) for word in words[1:]]
            if len(values) != count:
                raise ValueError(f"{len(words)} numbers")
            if not (np.abs(values) < _LARGEST).all():
                raise ValueError("one is not finite or too large")
            poses.append(pose_of(np.array(values)))
        except ValueError as error:
            raise InputError(f"{file} line {number}: expected '{expected}' ({error}).") from error
        times.append(time)
    order = np.argsort(np.array(times), kind="stable")
    return Trajectory(np.array(times, dtype=np.float64)[order], [poses[i] for i in order])


def time_stamp(word: str) -> float:
    """Seconds; ValueError for nan and inf, beside which no other stamp would be nearest."""
    time = float(word)
    if not math.isfinite(time):
        raise ValueError(f"the time stamp {word} is not finite")
    return time


def tum_pose(values: Float[np.ndarray, "7"]) -> Float[np.ndarray, "4 4"]:
    """From tx ty tz qx qy qz qw."""
    return pose_from_quaternion(values[:3], values[3:])


def text_lines(file: Path) -> list[tuple[int, list[str]]]:
    """(line number, words) of a text file, words parted by blanks or commas; `#` comments."""
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be read ({error}).") from error
    split = [
        (number, line.split("#")[0].replace(",", " ").split())
        for number, line in enumerate(lines, start=1)
    ]
    return [(number, words) for number, words in split if words]
