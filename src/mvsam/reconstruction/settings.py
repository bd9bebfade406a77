"""What a reconstruction keeps; apart from the code, so that `--help` need not load it."""

from dataclasses import dataclass
from math import inf

from mvsam.errors import InputError


@dataclass(frozen=True)
class CloudSettings:
    """What is kept of the depth maps, and how finely."""

    voxel_size: float = 0.02
    """Edge of the voxels that points are merged into, metres."""
    minimum_confidence: float = 0.4
    """Depths the network is less sure of are left out, 0..1."""
    minimum_consistent_views: int = 1
    """At least this many other photos must agree with a depth."""
    relative_tolerance: float = 0.03
    """Depths agree when they differ by at most this fraction."""
    neighbours: int = 6
    """How many overlapping photos each photo is compared with."""

    def __post_init__(self):
        if not 0 < self.voxel_size < inf:
            raise InputError(f"--voxel-size {self.voxel_size}: must be positive, metres")
        if not 0 <= self.minimum_confidence <= 1:
            raise InputError(f"--minimum-confidence {self.minimum_confidence}: lies from 0 to 1")
        for name in ("minimum_consistent_views", "relative_tolerance", "neighbours"):
            if not 0 <= getattr(self, name) < inf:
                option = "--" + name.replace("_", "-")
                raise InputError(f"{option} {getattr(self, name)}: must not be negative")
