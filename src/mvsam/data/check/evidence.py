"""Whether the cameras seem wrong, by measured depth or else by the photos."""

from collections.abc import Sequence
from dataclasses import dataclass

from mvsam.data.check.depth import Verdict, depth_verdict
from mvsam.data.check.poses import pose_convention_hint
from mvsam.data.depth_range import DepthRange
from mvsam.types import Frame

FEW_FRAMES = 5
"""With fewer, photos alone do not accuse the cameras where the depth sees no reason to."""


@dataclass(frozen=True)
class Evidence:
    """Both witnesses. Depth, where it can tell, overrules the photos."""

    num_frames: int
    depth: Verdict
    photos: str | None
    """What photos and viewing frusta say against the poses; None: nothing, or they were not asked,
    which takes ten times as long, because the depth can tell."""

    @staticmethod
    def of(frames: Sequence[Frame], depth_range: DepthRange) -> "Evidence":
        """Of a few dozen of the frames, however many there are."""
        verdict = depth_verdict(frames, depth_range)
        hint = None if verdict.fits is not None else pose_convention_hint(frames, depth_range)
        return Evidence(len(frames), verdict, hint)

    @property
    def advice(self) -> str:
        """What seems wrong and the remedy, in the sentence of the witness that decides."""
        decides = self.depth.fits is not None or self.photos is None
        return self.depth.sentence if decides else self.photos or ""

    @property
    def is_suspicious(self) -> bool:
        """Whether the cameras seem wrong.

        Where depth fits no convention, a handful of photos may match another one by chance.
        """
        if self.depth.fits is not None:
            return not self.depth.fits
        is_contradicted = bool(self.depth.agreement) and self.num_frames < FEW_FRAMES
        return self.photos is not None and not is_contradicted


def camera_warning(frames: Sequence[Frame], depth_range: DepthRange) -> str | None:
    """What seems wrong with the cameras and the remedy; None: nothing."""
    evidence = Evidence.of(frames, depth_range)
    return evidence.advice if evidence.is_suspicious else None
