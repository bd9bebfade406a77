"""ScanNet's `.sens` container: one file that holds a scan's colour, depth and poses.

Little-endian, version 4, as ScanNet's SensReader reads it. Opening reads the header and skims the
frames; pixels are read when a frame is asked for.
"""

import io
import struct
import zlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float, UInt8, UInt16
from PIL import Image

from mvsam.data.camera_checks import check_depth_scale
from mvsam.data.readers.register import read_at_pixels
from mvsam.errors import InputError, counted
from mvsam.geometry.camera import HALF_PIXEL
from mvsam.types import Frame

VERSION = 4
_JPEG_OR_PNG, _ZLIB = (1, 2), 1
_MOST_PIXELS = 16 * 2**20
"""Of a picture; ScanNet's have 1.3 million."""
_MOST_PACKED = 1032
"""Bytes that one byte of zlib's can stand for at most."""
_HEAD = struct.Struct("<16fQQQQ")
"""Of a frame: camera to world, two time stamps, bytes of colour, bytes of depth."""


@dataclass(frozen=True)
class SensHeader:
    """What holds for all frames of a scan."""

    color_intrinsics: Float[np.ndarray, "3 3"]
    """Corner convention, as the next."""
    depth_intrinsics: Float[np.ndarray, "3 3"]
    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    depth_units: float
    """In a metre."""


@dataclass(frozen=True)
class SensFrame:
    """Where a frame lies in the file."""

    world_from_cam: Float[np.ndarray, "4 4"]
    """Not finite where tracking was lost."""
    color_place: tuple[int, int]
    """(first byte, number of bytes)."""
    depth_place: tuple[int, int]


class SensFile:
    """The header and the places of all frames. Raises `InputError` for a file that is not whole."""

    def __init__(self, path: Path):
        self.path = path
        try:
            with path.open("rb") as file:
                self._end = file.seek(0, 2)
                file.seek(0)
                self.header, count = self._read_header(file)
                self.frames = self._skim(file, count)
        except (OSError, struct.error) as error:
            raise self._broken(f"it ends too early ({error})") from error

    def frame(self, index: int, **maps) -> Frame:
        """Frame `index` at the colour camera's size; `maps` are further fields of `Frame`."""
        frame, header = self.frames[index], self.header
        return Frame(
            name=f"{index:06d}",
            size=header.color_size,
            intrinsics=header.color_intrinsics.copy(),
            world_from_cam=frame.world_from_cam.copy(),
            load_image=partial(self.color, index),
            load_depth=partial(self.depth_for_color, index),
            **maps,
        )

    def color_file(self, index: int) -> bytes:
        """The JPEG or PNG as it is stored."""
        return self._bytes(self.frames[index].color_place)

    def color(self, index: int) -> UInt8[np.ndarray, "height width 3"]:
        """RGB."""
        data = self.color_file(index)
        try:
            with Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as picture:
                if picture.size != self.header.color_size:
                    raise ValueError(f"it is {picture.size}, not {self.header.color_size}")
                return np.array(picture.convert("RGB"))
        except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
            raise self._broken(f"colour of frame {index} cannot be decoded: {error}") from error

    def depth(self, index: int) -> Float[np.ndarray, "height width"]:
        """Metres at the depth camera's own size; 0 = unknown."""
        return self.depth_pixels(index).astype(np.float32) / np.float32(self.header.depth_units)

    def depth_pixels(self, index: int) -> UInt16[np.ndarray, "height width"]:
        """As stored: `depth_units` of the header are a metre."""
        width, height = self.header.depth_size
        packed, size = self._bytes(self.frames[index].depth_place), 2 * width * height
        if size > _MOST_PACKED * len(packed):  # known before memory is taken for it
            raise self._broken(f"depth of frame {index} is too short for {width}x{height} pixels")
        try:
            data = zlib.decompressobj().decompress(packed, size)
        except zlib.error as error:
            raise self._broken(f"depth of frame {index} cannot be unpacked: {error}") from error
        if len(data) != size:
            raise self._broken(f"depth of frame {index} has {len(data)} bytes")
        return np.frombuffer(data, "<u2").reshape(height, width)

    def depth_for_color(self, index: int) -> Float[np.ndarray, "height width"]:
        """Metres at the colour camera's pixels: the two share one viewpoint in ScanNet."""
        header = self.header
        return read_at_pixels(
            self.depth(index), header.depth_intrinsics, header.color_intrinsics, header.color_size
        )

    def _read_header(self, file: BinaryIO) -> tuple[SensHeader, int]:
        (version,) = _unpack(file, "<I")
        if version != VERSION:
            raise self._broken(f"its version is {version}, not {VERSION}; is it a .sens file")
        (length,) = _unpack(file, "<Q")
        if length > self._end:
            raise self._broken("the sensor's name is longer than the file")
        file.seek(length, 1)
        matrices = [np.array(_unpack(file, "<16f")).reshape(4, 4) for _ in range(4)]
        color_coding, depth_coding = _unpack(file, "<ii")
        color_w, color_h, depth_w, depth_h, units, count = _unpack(file, "<IIIIfQ")
        if color_coding not in _JPEG_OR_PNG or depth_coding != _ZLIB:
            raise self._broken(
                f"colour coding {color_coding} or depth coding {depth_coding} is not supported "
                "(JPEG or PNG, zlib)"
            )
        if not all(0 < pixels <= _MOST_PIXELS for pixels in (color_w * color_h, depth_w * depth_h)):
            raise self._broken(f"pictures of {color_w}x{color_h} and {depth_w}x{depth_h} pixels")
        check_depth_scale(units, str(self.path))
        if count > self._end // _HEAD.size:
            raise self._broken(f"it claims {counted(count, 'frame')} but is too short for them")
        header = SensHeader(
            _corner(matrices[0]), _corner(matrices[2]), (color_w, color_h), (depth_w, depth_h),
            units,
        )  # fmt: skip
        return header, count

    def _skim(self, file: BinaryIO, count: int) -> list[SensFrame]:
        frames = []
        for index in range(count):
            *pose, _, _, color_bytes, depth_bytes = _HEAD.unpack(_exactly(file, _HEAD.size))
            place = file.tell()
            if place + color_bytes + depth_bytes > self._end:
                raise self._broken(f"it ends inside frame {index} of {count}")
            file.seek(color_bytes + depth_bytes, 1)
            frames.append(
                SensFrame(
                    np.array(pose, dtype=np.float64).reshape(4, 4),
                    (place, color_bytes),
                    (place + color_bytes, depth_bytes),
                )
            )
        return frames

    def _bytes(self, place: tuple[int, int]) -> bytes:
        first, length = place
        try:
            with self.path.open("rb") as file:
                file.seek(first)
                return _exactly(file, length)
        except (OSError, struct.error) as error:
            raise self._broken(str(error)) from error

    def _broken(self, what: str) -> InputError:
        return InputError(f"{self.path}: cannot be read: {what}; copy or download it again.")


def _unpack(file: BinaryIO, layout: str) -> tuple:
    return struct.unpack(layout, _exactly(file, struct.calcsize(layout)))


def _exactly(file: BinaryIO, count: int) -> bytes:
    data = file.read(count)
    if len(data) < count:
        raise struct.error(f"{count} bytes wanted, {len(data)} left")
    return data


def _corner(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3 3"]:
    """ScanNet calibrates at integer pixel centres; ours lie at halves."""
    return matrix[:3, :3] + HALF_PIXEL
