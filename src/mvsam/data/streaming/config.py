"""What a run trains on and watches, and how its samples are drawn."""

from dataclasses import dataclass
from typing import Any

from mvsam.data.catalog import is_rooms
from mvsam.data.scaled import parse_scale
from mvsam.data.streaming.mixture import parse_sources
from mvsam.errors import InputError


@dataclass(frozen=True)
class DataConfig:
    """What a run trains on and watches."""

    train: str = "rooms:train:0-3000"
    """Scenes to train on: rooms:SPLIT:FIRST-END or a path; several in given shares as
    `0.7 @ rooms:train:0-3000 + 0.3 @ scans/scannetv2_train.txt`."""
    val: str = "rooms:val:0-20"
    """Scenes to watch while training."""
    format: str | None = None
    """Of the recorded scans in `train` and `val`, as `mvsam predict --format`; none: found."""
    scale: str = "1"
    """Metres a unit of their poses, or A:B=METRES, as `mvsam predict --scale`; for one recorded
    source alone."""
    tuples: str | None = None
    """Which frames of recorded scans go together: mvs2d, every-100, keyframes, or a file of tuples,
    as `mvsam eval --tuples`; none: a scene's own, or by overlap. All recorded
    sources of a mixture follow this one rule; rooms have their own. `val` is
    watched by the same rule, not by a file."""
    num_views: int = 3
    """The paper's M."""
    fewest_views: int | None = None
    """From step to step the number of views changes, drawn evenly from these to `num_views`; none:
    always `num_views`."""
    references: int = 1
    """How many views of each tuple serve as reference in turn; they share their features
    ("we repeat this M times", Sec. 3)."""
    size: tuple[int, int] = (320, 256)
    """(width, height) of the training pictures, pixels."""
    crop: bool = False
    """Cut frames centrally to the shape of `size`. The paper leaves open how 4:3 frames become 5:4
    pictures; we stretch the whole frame."""
    semantic_size: tuple[int, int] | None = None
    """(width, height) of the photos for SAM, as 1024 768. The paper leaves open what it sees; we
    give it the pictures of `size`, enlarged (none)."""
    depth_range: tuple[float, float] = (0.1, 5.0)
    """Metres."""
    farthest: tuple[float, float] | None = None
    """Metres; the end of the depth range is drawn anew for each sample between these, evenly in its
    logarithm; none: that of `depth_range`. Deeper pixels teach no depth."""
    pose_noise: tuple[float, float] = (0.0, 0.0)
    """Standard deviations of errors that are added to every view's pose: metres along each axis,
    degrees about each axis. Depth stays that of the true camera."""
    least_pose_noise_share: float = 1.0
    """Each sample's share of `pose_noise` is drawn evenly from this, 0 to 1, to 1; with 0 a model
    sees exact cameras too."""
    room_frames: int = 5
    """Frames rendered of each procedural room to train on, at `semantic_size` or else `size`; at
    least `num_views`."""
    cache: str | None = None
    """Folder for rendered rooms, and for the frames of scans at the training size (about 0.5 MB a
    frame); none: render, or decode, anew every time."""
    assets: str | None = None
    """Folder of an asset pack, whose things and surfaces then occur in the rooms to train on."""
    views_part: float = 1.0
    """In half of the samples each view is a part of its photo, as if cameras looked elsewhere
    through longer lenses: the smallest share of the photo's sides; 1: the whole photos."""
    mirror: bool = False
    """Show every other sample, drawn at random, as in a mirror (all its views, exact cameras)."""
    color_jitter: float = 0.0
    """Spread of the exposure, colour and contrast drawn anew for each view (0.2 is moderate)."""
    prompt_noise: float = 0.0
    """Spread of the logarithm of made-up errors in half of the measured depth maps, those of
    `singles` too, which prompt a model of one view; 0.1 is much. A prompt that is never wrong is
    believed too much later."""
    singles: str | None = None
    """Folder of labelled photos without poses (`SingleViews`); each teaches labels, prompted with
    its measured depth, and the prior of a model that has one. None: rooms alone."""
    singles_per_sample: int = 1
    """How many of them come with each sample of `train`."""
    singles_without: tuple[str, ...] = ()
    """Lists of photos that are never shown: text files, or nyuv2_heldout and nyuv2_posed, which
    come with the package."""
    singles_part: float = 0.6
    """Smallest share of a photo's sides that is cut out anew each time; 1: the whole photo."""
    workers: int | None = None
    """Processes that load or render data, for each training process; none: what the machine's cores
    leave, 15 at most. 0: the training process does it."""

    def of_scans(self, name: str) -> dict[str, Any]:
        """What `open_data` is told of a source that is no rooms.

        InputError for a scale where several are mixed, which may have another unit each.
        """
        if is_rooms(name):
            return {}
        recorded = [source for source in parse_sources(self.train) if not is_rooms(source.name)]
        if len(recorded) > 1 and parse_scale(self.scale) != 1.0:
            raise InputError(
                f"--data.scale {self.scale}: is of one recorded source, but --data.train has "
                f"{len(recorded)}; convert those that are not in metres first "
                "(mvsam data convert SCENE --scale ... --out FOLDER) and leave the option out."
            )
        return {"format": self.format, "scale": self.scale}
