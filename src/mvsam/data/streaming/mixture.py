"""Several sources of training data in given shares, as `0.7 @ rooms:train:0-3000 + 0.3 @ scans`."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mvsam.errors import InputError

BLOCK = 100
"""Samples in a row in which every source has its share, to the hundredth."""


@dataclass(frozen=True)
class Source:
    """Data as `open_data` names them, and their weight beside the others."""

    weight: float
    name: str


def parse_sources(text: str) -> list[Source]:
    """`NAME`, or `WEIGHT @ NAME + WEIGHT @ NAME ...`; a weight left out is 1.

    The blanks around `@` and `+` belong to them, so that paths may hold either.
    """
    return [_parse_source(part) for part in text.split(" + ")]


def _parse_source(part: str) -> Source:
    weight, at, name = part.strip().rpartition(" @ ")
    try:
        number = float(weight) if at else 1.0
    except ValueError:
        number = 0.0
    if not (np.isfinite(number) and number > 0 and name.strip()):
        raise InputError(f"'{part}': expected WEIGHT @ DATA with a weight above 0, as 0.5 @ scans.")
    return Source(number, name.strip())


class Mixture:
    """Which source sample n comes from, a function of (seed, n) alone.

    Each block of 100 samples holds every source as often as its weight says, at least once, in an
    order drawn anew.
    """

    def __init__(self, weights: Sequence[float], seed: int):
        if len(weights) > BLOCK:
            raise InputError(f"{len(weights)} sources of training data; at most {BLOCK} mix.")
        self.seed = seed
        self.quotas = _quotas(np.asarray(weights, dtype=float))

    def __call__(self, n: int) -> tuple[int, int]:
        """(source, how many samples before this one came from it)."""
        block, position = divmod(n, BLOCK)
        order = _order(self.seed, block, self.quotas)
        source = int(order[position])
        before = int((order[:position] == source).sum())
        return source, block * self.quotas[source] + before


def _quotas(weights: np.ndarray) -> tuple[int, ...]:
    """Samples of each source in a block: one, and of the rest its share by largest remainders."""
    shares = weights / weights.sum() * BLOCK
    quotas = np.maximum(1, np.floor(shares)).astype(int)
    while quotas.sum() != BLOCK:
        step = 1 if quotas.sum() < BLOCK else -1
        lacking = np.where(quotas + step > 0, step * (shares - quotas), -np.inf)
        quotas[lacking.argmax()] += step
    return tuple(quotas.tolist())


@lru_cache(maxsize=4)
def _order(seed: int, block: int, quotas: tuple[int, ...]) -> np.ndarray:
    sources = np.repeat(np.arange(len(quotas)), quotas)
    return np.random.default_rng((seed, block, 4)).permutation(sources)
