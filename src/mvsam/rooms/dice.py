"""Random decisions of the rooms, built on nothing but uniform doubles.

NumPy keeps `Generator.random` stable; its other methods may change their streams between
versions, and a scene must stay the same for ever.
"""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Float

Item = TypeVar("Item")
Number = float | int
"""A length, an angle or a chance; whole ones are written as integers."""


class Dice:
    """A stream of random choices that depends on its key only."""

    def __init__(self, *key: int):
        sequence = np.random.SeedSequence(key)
        self._generator = np.random.Generator(np.random.PCG64(sequence))

    def uniform(self, low: Number = 0.0, high: Number = 1.0) -> float:
        return low + (high - low) * float(self._generator.random())

    def chance(self, probability: Number) -> bool:
        return self.uniform() < probability

    def count(self, low: int, high: int) -> int:
        """An integer from low to high, both included."""
        return min(high, low + int(self.uniform() * (high - low + 1)))

    def pick(self, items: Sequence[Item]) -> Item:
        return items[self.count(0, len(items) - 1)]

    def weighted(self, weights: Sequence[Number]) -> int:
        """An index, drawn in proportion to the weights."""
        total = np.cumsum(np.asarray(weights, dtype=np.float64))
        return min(len(weights) - 1, int(np.searchsorted(total, self.uniform() * total[-1])))

    def shuffled(self, items: Sequence[Item]) -> list[Item]:
        order = np.argsort(self._generator.random(len(items)), kind="stable")
        return [items[i] for i in order]

    def normal(self, *shape: int) -> Float[np.ndarray, "..."]:
        """Nearly normal float32 numbers: a sum of four uniforms, mean 0, deviation 1."""
        total = self._generator.random((4, *shape), dtype=np.float32).sum(axis=0)
        return (total - 2.0) * np.float32(np.sqrt(3.0))

    def array(self, *shape: int) -> Float[np.ndarray, "..."]:
        """Uniform float64 numbers in [0, 1)."""
        return self._generator.random(shape)
