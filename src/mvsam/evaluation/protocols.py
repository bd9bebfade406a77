"""Named evaluation protocols: which pixels count, and at which size."""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

Size = tuple[int, int]
"""(width, height), pixels."""


@dataclass(frozen=True)
class Protocol:
    """What two scores must share to be comparable."""

    name: str
    size: Size = (320, 256)
    """Of the pictures that the network sees, area-resized, no crop, unless others are asked for."""
    depth_range: tuple[float, float] = (0.1, 5.0)
    """Metres; ground truth outside is left out of the depth scores."""
    includes_bounds: bool = True
    """Whether ground truth exactly at an end of the range counts."""
    num_views: int = 3
    """Reference and sources, unless another number is asked for."""
    tuples_per_scene: int | None = None
    """At most so many view tuples of a scene, evenly spaced; None takes all."""
    score_size: Size | None = None
    """Of ground truth and prediction when they are compared, both resized to the nearest pixel;
    None: `size`."""
    search_range: tuple[float, float] | None = None
    """Metres between which the network looks for surfaces; None: `depth_range`."""
    clamps: bool = False
    """Whether predictions outside `depth_range` are moved to its end first."""

    @property
    def truth_size(self) -> Size:
        """(width, height) of the ground truth."""
        return self.score_size or self.size

    def valid_depth(self, depth: Float[Tensor, "*any"]) -> Bool[Tensor, "*any"]:
        """Where ground truth counts. Compare as given: in float64, float32's 0.1 exceeds 0.1."""
        nearest, farthest = self.depth_range
        if self.includes_bounds:
            return (depth > 0) & (depth >= nearest) & (depth <= farthest)
        return (depth > nearest) & (depth < farthest)

    def compared_depth(self, depth: Float[Tensor, "*any"]) -> Float[Tensor, "*any"]:
        """A prediction as it enters the scores."""
        return depth.clamp(*self.depth_range) if self.clamps else depth


PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        # The paper evaluates at its own 320x256 within its depth range (facts of its Sec. 4).
        Protocol("paper"),
        # MVS2D's code: hypotheses over 0.3-10.1 m, truth in (0.5, 10) m, predictions clamped.
        Protocol(
            "mvs2d",
            depth_range=(0.5, 10.0),
            includes_bounds=False,
            score_size=(640, 480),
            search_range=(0.3, 10.1),
            clamps=True,
        ),
        # ScanNet's 2D benchmark scores labels alone; depth as in the paper, at its size. Its rule
        # for ignored pixels is `ConfusionMatrix`'s: they count nowhere, not as false positives.
        Protocol("scannet-2d", score_size=(640, 480)),
        # The tables' rows on procedural rooms, trained at half the size for two CPU cores.
        Protocol("half", size=(160, 128)),
        # Real photographs with sensor depth: bounded work on long sequences.
        Protocol("real", includes_bounds=False, tuples_per_scene=24),
    )
}
