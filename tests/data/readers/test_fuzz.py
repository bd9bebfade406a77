"""Whatever the bytes of a scene's files say, only our own error comes out, and soon.

Each case is a whole folder of one format in which a file was cut, overwritten in places, replaced
by made-up text, or given one absurd word or value.
"""

import contextlib
import json
import re
import shutil
import time
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from mvsam.data.formats import FORMATS
from mvsam.data.splits import listed_scenes, read_tuples
from mvsam.errors import InputError
from mvsam.types import Frame
from tests.data.readers.layouts import LAYOUTS, write_views_and_classes
from tests.synthetic import synthetic_views

QUICK = settings(
    max_examples=15,
    deadline=None,
    database=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
FUZZED = {
    "posed-folder": (
        "intrinsics.txt", "poses/0000.txt", "color/0000.png", "depth/0000.png", "views.txt",
        "classes.json",
    ),
    "nerfstudio": ("transforms.json", "depth/0000.png"),
    "colmap": ("sparse/0/cameras.txt", "sparse/0/images.txt"),
    "scannet": ("pose/0.txt", "intrinsic/intrinsic_depth.txt", "label-filt/0.png"),
    "scannet-sens": ("scan.sens", "scan_2d-label-filt.zip", "scannetv2-labels.combined.tsv"),
    "tum": ("rgb.txt", "depth.txt", "groundtruth.txt", "intrinsics.txt"),
    "ios-logger": ("Frames.txt", "ARposes.txt"),
    "arkitscenes": (
        "scene_frames/lowres_wide_intrinsics/scene_4300.000.pincam",
        "scene_frames/lowres_wide.traj",
    ),
    "replica": ("traj.txt", "cam_params.json", "results/depth000000.png"),
}  # fmt: skip


def small_frames() -> list[Frame]:
    return [
        Frame(
            v.name, (64, 48), v.intrinsics, v.world_from_cam,
            lambda v=v: v.image, lambda v=v: v.depth, lambda v=v: v.labels,
        )
        for v in synthetic_views(2)
    ]  # fmt: skip


@pytest.fixture(scope="module", params=[(f, file) for f in FUZZED for file in FUZZED[f]], ids=str)
def broken(request, tmp_path_factory):
    """(format, folder, file to break, its content)."""
    name, file = request.param
    folder = tmp_path_factory.mktemp("fuzz") / "scene"
    LAYOUTS[name].write(small_frames(), folder)
    if name == "posed-folder":
        write_views_and_classes(folder)
    return name, folder, folder / file, (folder / file).read_bytes()


MOST_MEMORY = 32 * 2**20
"""Bytes that a scene of 64x48 pixels may take; its files have a few kilobytes."""
MOST_SECONDS = 5
"""Of the processor; a scene takes some hundredths."""


@contextlib.contextmanager
def bounded() -> Iterator[None]:
    """Fails where Python and NumPy took more memory or time than a small file can need."""
    start = time.process_time()
    tracemalloc.start()
    try:
        yield
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < MOST_MEMORY and time.process_time() - start < MOST_SECONDS


def read_everything(name: str, folder: Path) -> None:
    """Opens the scene and decodes all within bounds; InputError is the only way to fail."""
    with bounded():
        read_all_or_refuse(name, folder)


def read_all_or_refuse(name: str, folder: Path) -> None:
    try:
        scene = FORMATS[name].open(folder)
        for index in range(len(scene)):
            frame = scene.frame(index)
            assert frame.image.dtype == np.uint8
            _ = frame.depth, frame.labels
    except InputError as error:
        assert "\n" not in str(error).strip()


ABSURD_WORDS = (
    ".", "/", "..", "a/..", "x" * 300, "x/" * 3000, "9" * 400, "9" * 5000, "-1", "0", "nan", "inf",
    "1e999", "1e200", "1e-320",
)  # fmt: skip
ABSURD_VALUES = (
    *ABSURD_WORDS, 10**400, -(10**400), -1, 0, float("nan"), float("inf"), 1e200, 1e-320,
    None, [], {},
)  # fmt: skip
numbers = st.one_of(
    st.integers(-(2**70), 2**70),
    st.floats(allow_nan=True),
    st.sampled_from(["-inf", "1e400", "x", 10**400]),
)
texts = st.one_of(
    st.text(max_size=200),
    st.lists(st.lists(numbers, max_size=17), max_size=6).map(
        lambda rows: "\n".join(" ".join(map(str, row)) for row in rows)
    ),
    st.recursive(
        st.one_of(st.none(), st.booleans(), numbers, st.text(max_size=8)),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner),
        max_leaves=12,
    ).map(lambda value: json.dumps(value, allow_nan=True)),
)


def places(value: Any) -> Iterator[Callable[[Any], None]]:
    """For each value inside parsed JSON what puts another in its place."""
    keys = range(len(value)) if isinstance(value, list) else value
    if isinstance(value, list | dict):
        for key in keys:
            yield lambda new, key=key: value.__setitem__(key, new)
            yield from places(value[key])


def with_an_absurd_value(content: bytes, draw: Callable[[st.SearchStrategy], Any]) -> bytes:
    """Of JSON one value, of other text one word, is replaced by what breaks careless readers."""
    with contextlib.suppress(ValueError):
        value = json.loads(content)
        draw(st.sampled_from([*places(value)]))(draw(st.sampled_from(ABSURD_VALUES)))
        return json.dumps(value).encode()
    words = [*re.finditer(rb"[^\s,]+", content)]
    word = words[draw(st.integers(0, len(words) - 1))]
    absurd = draw(st.sampled_from(ABSURD_WORDS)).encode()
    return content[: word.start()] + absurd + content[word.end() :]


@QUICK
@given(data=st.data())
def test_an_absurd_word_or_value_ends_in_our_own_error_or_is_read(broken, data):
    name, folder, file, content = broken
    file.write_bytes(with_an_absurd_value(content, data.draw))
    try:
        read_everything(name, folder)
    finally:
        file.write_bytes(content)


@QUICK
@given(data=st.data())
def test_broken_files_end_in_our_own_error_or_are_read(broken, data):
    name, folder, file, content = broken
    edits = st.lists(
        st.tuples(st.integers(0, max(0, len(content) - 1)), st.binary(min_size=1, max_size=8)),
        min_size=1,
        max_size=4,
    )
    how = data.draw(st.sampled_from(["cut", "edit", "replace"]))
    if how == "cut":
        file.write_bytes(content[: data.draw(st.integers(0, len(content)))])
    elif how == "edit":
        changed = bytearray(content)
        for place, value in data.draw(edits):
            changed[place : place + len(value)] = value
        file.write_bytes(changed)
    else:
        file.write_bytes(data.draw(texts).encode("utf-8", "surrogatepass"))
    try:
        read_everything(name, folder)
    finally:
        file.write_bytes(content)


@QUICK
@given(value=st.dictionaries(
    st.sampled_from(["fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "camera_angle_x", "camera_model",
                     "depth_unit_scale_factor", "frames"]),
    st.one_of(numbers, st.none(), st.text(max_size=5), st.lists(st.integers(), max_size=3)),
))  # fmt: skip
def test_any_values_of_transforms_json_are_read_or_refused(tmp_path, value):
    folder = tmp_path / "scene"
    if not folder.exists():
        LAYOUTS["nerfstudio"].write(small_frames(), folder)
    file = folder / "transforms.json"
    content = file.read_text()
    file.write_text(json.dumps(json.loads(content) | value))
    try:
        read_everything("nerfstudio", folder)
    finally:
        file.write_text(content)


@QUICK
@given(
    content=st.one_of(
        st.binary(max_size=200), texts.map(lambda text: text.encode("utf-8", "replace"))
    )
)
@pytest.mark.parametrize("name", ["split.npy", "split.txt"])
def test_any_split_file_is_read_or_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    for read in (read_tuples, listed_scenes):
        with contextlib.suppress(InputError):
            read(tmp_path / name)


def test_a_picture_of_absurd_size_is_refused_before_memory_is_taken(tmp_path):
    LAYOUTS["posed-folder"].write(small_frames(), tmp_path / "scene")
    file = tmp_path / "scene/color/0000.png"
    content = bytearray(file.read_bytes())
    content[16:24] = (60_000).to_bytes(4, "big") * 2
    content[29:33] = zlib.crc32(content[12:29]).to_bytes(4, "big")
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"0000\.png: the photo cannot be read"):
        FORMATS["posed-folder"].open(tmp_path / "scene")


@pytest.mark.parametrize("suffix", ["eps", "gif", "sgi"])
def test_only_what_photos_are_kept_as_is_decoded(tmp_path, suffix):
    """Pillow alone would run Ghostscript for the first of these."""
    LAYOUTS["posed-folder"].write(small_frames(), tmp_path / "scene")
    Image.new("RGB", (64, 48)).save(tmp_path / f"picture.{suffix}")
    (tmp_path / f"picture.{suffix}").rename(tmp_path / "scene/color/0000.png")
    with pytest.raises(InputError, match=r"0000\.png: the photo cannot be read"):
        FORMATS["posed-folder"].open(tmp_path / "scene")


def test_every_format_is_fuzzed_or_shares_its_parser():
    shared = {"icl-nuim", "7-scenes"}
    assert set(FUZZED) | shared == set(FORMATS)


@pytest.mark.parametrize("name", ["tum", "replica", "arkitscenes", "scannet"])
def test_a_depth_map_of_8_bits_is_refused(tmp_path, name):
    folder = tmp_path / "42"
    LAYOUTS[name].write(small_frames(), folder)
    for file in folder.rglob("depth*/*.png"):
        Image.new("L", (64, 48)).save(file)
    for file in [*folder.rglob("lowres_depth/*.png"), *folder.rglob("depth0*.png")]:
        Image.new("L", (64, 48)).save(file)
    with pytest.raises(InputError, match=r"pixel type L|has 8 bits"):
        scene = FORMATS[name].open(folder)
        _ = scene.frame(0).depth


def test_a_picture_that_is_not_there_is_named(tmp_path):
    LAYOUTS["replica"].write(small_frames(), tmp_path / "scene")
    shutil.rmtree(tmp_path / "scene/results")
    (tmp_path / "scene/results").mkdir()
    with pytest.raises(InputError, match="0 photos but 2 poses"):
        FORMATS["replica"].open(tmp_path / "scene")
