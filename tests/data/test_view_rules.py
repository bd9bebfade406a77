"""Published rules of views, tuples from files, keyframes, and recordings too long for all pairs."""

import io
import pickle
from dataclasses import replace

import numpy as np
import pytest

from mvsam.data import sampling
from mvsam.data.keyframes import keyframes
from mvsam.data.readers.listed import ListedScene
from mvsam.data.sampling import rank_sources, view_tuples
from mvsam.data.splits import read_tuples
from mvsam.data.view_rules import frame_numbers, prescribe, window_tuples
from mvsam.errors import InputError
from mvsam.types import Frame
from tests.synthetic import camera_intrinsics

RANGE = (0.1, 5.0)


def no_pixels():
    raise AssertionError("choosing views must not read pictures")


def recording(numbers, step: float = 0.01, name: str = "scene0170_01") -> ListedScene:
    """A camera that walks `step` metres a frame to the right."""
    frames = []
    for number in numbers:
        pose = np.eye(4)
        pose[0, 3] = step * number
        frames.append(
            Frame(f"{number:06d}", (64, 48), camera_intrinsics((64, 48)), pose, no_pixels)
        )
    return ListedScene(name, frames)


def names(scene, tuples) -> list[tuple[int, ...]]:
    return [tuple(int(scene.frame(i).name) for i in views) for views in tuples]


def test_mvs2d_takes_frames_twenty_before_and_behind():
    scene = recording(range(0, 1300))
    tuples = names(scene, window_tuples(scene, 3))
    assert (1120, 1100, 1140) in tuples, "the sample that the paper names"
    assert tuples[0] == (0, 20, 40) and tuples[-1] == (1280, 1260, 1240), "shifted at the ends"
    assert len(tuples) == 65


def test_five_views_reach_forty_frames():
    scene = recording(range(0, 400))
    tuples = names(scene, window_tuples(scene, 5))
    assert (200, 180, 220, 160, 240) in tuples
    assert tuples[1] == (20, 0, 40, 60, 80)


def test_references_of_the_2d_benchmark_are_a_hundred_frames_apart():
    scene = recording(range(0, 350))
    tuples = names(scene, window_tuples(scene, 3, reference_step=100))
    assert tuples == [(0, 20, 40), (100, 80, 120), (200, 180, 220), (300, 280, 320)]


def test_lost_frames_keep_the_numbers_of_the_others():
    scene = recording([n for n in range(0, 200) if n not in (40, 41)])
    assert (20, 0, 60) in names(scene, window_tuples(scene, 3))


def test_a_rule_for_recordings_refuses_a_few_photos():
    with pytest.raises(InputError, match="1 have a number that divides by 20"):
        window_tuples(recording(range(5)), 3)


def test_names_without_numbers_are_counted():
    frames = [replace(recording([i]).frame(0), name=f"view{'abc'[i]}") for i in range(3)]
    assert frame_numbers(ListedScene("room", frames)) == [0, 1, 2]


def test_keyframes_moved_or_turned_since_the_last_one():
    scene = recording(range(0, 100), step=0.03)
    poses = [scene.frame(i).world_from_cam for i in range(100)]
    assert keyframes(poses, baseline=0.1) == list(range(0, 100, 4))
    turned = poses[0].copy()
    turned[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    assert keyframes([poses[0], poses[0], turned]) == [0, 2]
    assert keyframes([]) == []


def test_the_rule_of_keyframes_leaves_the_others_out():
    (scene,) = prescribe([recording(range(40), step=0.03)], "keyframes", 3, RANGE)
    tuples, _ = view_tuples(scene, 3, RANGE)
    assert {i for views in tuples for i in views} <= set(range(0, 40, 4))
    assert all(len(views) == 3 for views in tuples)


def test_an_unknown_rule_lists_the_known_ones():
    with pytest.raises(InputError, match="choose one of mvs2d, every-100, keyframes"):
        prescribe([recording(range(3))], "deepvmvs", 3, RANGE)


ENTRIES = [
    {"scene": "scene0170_01", "target": 1120, "refs": [1100, 1140]},
    {"scene": "scene0170_01", "target": 40, "refs": np.array([20, 60])},
    {"scene": "scene0000_00", "target": 0, "refs": [20, 40]},
]


@pytest.fixture(params=["npy", "txt"])
def split(request, tmp_path):
    file = tmp_path / f"ScanNet_3_frame_test.{request.param}"
    if request.param == "npy":
        np.save(file, np.array(ENTRIES, dtype=object), allow_pickle=True)
    else:
        lines = [" ".join(map(str, (e["scene"], e["target"], *e["refs"]))) for e in ENTRIES]
        file.write_text("# scene, reference, sources\n" + "\n".join(lines))
    return file


def test_the_split_files_of_mvs2d_choose_scenes_and_tuples(split):
    scenes = [recording(range(1300)), recording(range(9), name="scene0707_00")]
    (scene,) = prescribe(scenes, str(split), 3, RANGE)
    assert names(scene, scene.views()) == [(1120, 1100, 1140), (40, 20, 60)]
    (pair,) = prescribe(scenes, str(split), 2, RANGE)
    assert names(pair, pair.views()) == [(1120, 1100), (40, 20)]


def test_tuples_of_frames_that_are_not_there_are_named(split):
    with pytest.raises(InputError, match=r"frame 1120 of scene0170_01 is not among its 1000"):
        prescribe([recording(range(1000))], str(split), 3, RANGE)


def test_a_split_of_other_scenes_is_refused(split):
    with pytest.raises(InputError, match=r"names none of these scenes \(kitchen, "):
        prescribe([recording(range(9), name="kitchen")], str(split), 3, RANGE)


def test_a_missing_split_says_where_its_authors_share_it(tmp_path):
    with pytest.raises(InputError, match="OneDrive"):
        read_tuples(tmp_path / "ScanNet_3_frame_val.npy")


class Trap:
    def __reduce__(self):
        return (print, ("a stranger's code ran",))


@pytest.mark.parametrize("entry", [Trap(), {"scene": "a"}, 3, "text", {"scene": 1, "target": 2}])
def test_a_strangers_pickle_is_refused_and_not_run(tmp_path, entry, capsys):
    file = tmp_path / "split.npy"
    np.save(file, np.array([entry, 1], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="expected MVS2D's list"):
        read_tuples(file)
    assert capsys.readouterr().out == ""


def npy(pickled: bytes) -> bytes:
    """A .npy file of one object, whose pickle is this."""
    buffer = io.BytesIO()
    header = {"descr": "|O", "fortran_order": False, "shape": (1,)}
    np.lib.format.write_array_header_1_0(buffer, header)
    return buffer.getvalue() + pickled


@pytest.mark.parametrize("protocol", [2, 3, 4])
def test_splits_of_every_numpy_are_read(tmp_path, protocol):
    entry = {"scene": np.str_("a"), "target": np.int64(20), "refs": np.array([0, 40])}
    pickled = pickle.dumps(np.array([entry], dtype=object), protocol)
    (tmp_path / "split.npy").write_bytes(npy(pickled))
    assert read_tuples(tmp_path / "split.npy") == {"a": [(20, 0, 40)]}


def nested(depth: int) -> bytes:
    """The pickle of a list that holds a list twice, which holds a list twice, and so on."""
    value: list = []
    for _ in range(depth):
        value = [value, value]
    return pickle.dumps([{"scene": value, "target": 1, "refs": [2]}], 4)


def frame(length: int) -> bytes:
    """The beginning of a frame of a pickle."""
    return b"\x95" + length.to_bytes(8, "little")


class Array:
    """Pickled as an array of this type and these bytes; a type may have a state of its own."""

    def __init__(self, *kind, data=b"12"):
        self.kind, self.data = kind, data

    def __reduce__(self):
        make = np.empty(0).__reduce__()[0]
        return make, (np.ndarray, (0,), b"b"), (1, (2**33,), Type(self.kind), False, self.data)


class Type:
    def __init__(self, kind):
        self.kind = kind

    def __reduce__(self):
        return np.dtype, self.kind[:1], *self.kind[1:]


ODD = (3, "|", None, None, None, -1, -1, 63)
"""A state that NumPy's own types of time crash for."""


def split_of(sources) -> bytes:
    return pickle.dumps([{"scene": "a", "target": 1, "refs": sources}], 4)


@pytest.mark.parametrize(
    "pickled, message",
    [
        (frame(2**60) + b"].", "holds no view tuple"),
        (frame(12) + b"]" + frame(5) + b"C\x05r\xff\xff\xff\x7f.", "not subscriptable"),
        (b"\x80\x02]r" + (2**31).to_bytes(4, "little") + b".", "LONG_BINPUT of"),
        (b"\x80\x04\x8e" + (2**40).to_bytes(8, "little") + b".", "only 1 remain"),
        (split_of(Array("i8")), "buffer size must be a multiple"),
        (split_of(Array("i1", data=bytes(5000))), "a str as scene with 1001 sources"),
        (split_of(Array("M8", ODD)), "numbers of type M8"),
        (split_of(Array("V99999999")), "numbers of type V"),
        (nested(60), "a list as scene"),
    ],
    ids=["frame", "frame in frame", "memo", "bytes", "array", "sources", "time", "void", "lists"],
)
def test_a_split_that_claims_more_than_it_holds_is_refused_before_memory_is_taken(
    tmp_path, pickled, message
):
    (tmp_path / "split.npy").write_bytes(npy(pickled))
    with pytest.raises(InputError, match=message):
        read_tuples(tmp_path / "split.npy")


@pytest.mark.parametrize(
    "content", [b"", b"\x93NUMPY\x01\x00", pickle.dumps([{"scene": "a"}]), b"\x93NUMPY\x09\x00v"]
)
def test_what_is_no_npy_file_is_refused(tmp_path, content):
    (tmp_path / "split.npy").write_bytes(content)
    with pytest.raises(InputError, match="expected MVS2D's list"):
        read_tuples(tmp_path / "split.npy")


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "holds no view tuple"),
        ("scene 1", "no reference with sources"),
        ("scene 1 1", "no reference with sources"),
        ("scene 1 x", "line 1: expected"),
    ],
)
def test_malformed_lists_of_tuples_say_so(tmp_path, text, message):
    (tmp_path / "split.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        read_tuples(tmp_path / "split.txt")


def test_long_recordings_find_sources_as_far_away_as_all_pairs_would(monkeypatch):
    scene = recording(range(0, 120), step=0.06)
    frames = [scene.frame(index) for index in range(len(scene))]

    def steps(tuples):
        return [[abs(source - views[0]) for source in views[1:]] for views in tuples]

    whole, _ = rank_sources(frames, RANGE, 3)
    monkeypatch.setattr(sampling, "MOST_AT_ONCE", 80)
    parts, skipped = rank_sources(frames, RANGE, 3)
    assert skipped == [] and [views[0] for views in parts] == list(range(120))
    assert steps(parts) == steps(whole), "before or behind is equally good"
