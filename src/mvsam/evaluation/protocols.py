"""Named evaluation protocols: which pixels count, and at which size."""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True)
class Protocol:
    """What two scores must share to be comparable."""

    name: str
    size: tuple[int, int] = (320, 256)
    """(width, height) of images (area-resized) and ground truth (nearest), pixels; no crop."""
    depth_range: tuple[float, float] = (0.1, 5.0)
    """Metres; ground truth outside is left out of the depth scores."""
    includes_bounds: bool = True
    """Whether ground truth exactly at an end of the range counts."""
    num_views: int = 3
    """Reference and sources, unless another number is asked for."""
    tuples_per_scene: int | None = None
    """At most so many view tuples of a scene, evenly spaced; None takes all."""

    def valid_depth(self, depth: Float[Tensor, "*any"]) -> Bool[Tensor, "*any"]:
        """Where ground truth counts. Compare as given: in float64, float32's 0.1 exceeds 0.1."""
        nearest, farthest = self.depth_range
        if self.includes_bounds:
            return (depth > 0) & (depth >= nearest) & (depth <= farthest)
        return (depth > nearest) & (depth < farthest)


PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        # The paper evaluates at its own 320x256 within its depth range (facts of its Sec. 4).
        Protocol("paper"),
        # The tables' rows on procedural rooms, trained at half the size for two CPU cores.
        Protocol("half", size=(160, 128)),
        # Real photographs with sensor depth: bounded work on long sequences.
        Protocol("real", includes_bounds=False, tuples_per_scene=24),
    )
}
