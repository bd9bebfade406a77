"""Single pictures out of a video, decoded once into JPEGs beside it."""

from collections.abc import Callable
from pathlib import Path

from mvsam.errors import InputError, MissingExtraError
from mvsam.files import write_whole

VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm")
_JPEG = {"format": "JPEG", "quality": 95, "subsampling": 0}


def extract_frames(
    video: Path, folder: Path, is_wanted: Callable[[int], bool], end: int | None = None
) -> dict[int, Path]:
    """Frame number -> `folder/NNNNNN.jpg` of the wanted frames that the video has.

    Pictures are as stored: a phone's note to turn them is not obeyed, because poses belong to the
    sensor. What is there already is kept. end: no frame from here on is wanted; None: unknown.
    """
    av = _import_av()
    files: dict[int, Path] = {}
    try:
        with av.open(str(video)) as container:
            for number, frame in enumerate(container.decode(video=0)):
                if end is not None and number >= end:
                    break
                if is_wanted(number):
                    files[number] = folder / f"{number:06d}.jpg"
                    _write(frame, files[number])
    except (av.error.FFmpegError, IndexError, ValueError) as error:
        raise InputError(f"{video}: cannot be read as a video ({error}); copy it again.") from error
    return files


PICTURES_PER_SECOND = 2


def thinned_frames(video: Path, folder: Path) -> dict[int, Path]:
    """`extract_frames` of two pictures a second, evenly spaced."""
    av = _import_av()
    try:
        with av.open(str(video)) as container:
            rate = float(container.streams.video[0].average_rate or 30)
    except (av.error.FFmpegError, IndexError, ValueError) as error:
        raise InputError(f"{video}: cannot be read as a video ({error}); copy it again.") from error
    step = max(1, round(rate / PICTURES_PER_SECOND))
    return extract_frames(video, folder, lambda number: number % step == 0)


def _write(frame, file: Path) -> None:
    if not file.exists():
        picture = frame.to_image()
        write_whole(file, lambda stream: picture.save(stream, **_JPEG))


def _import_av():
    try:
        import av
        import av.error
    except ImportError as error:
        raise MissingExtraError("videos", "av", "video") from error
    return av
