import gc
import pickle
import sys
import weakref

import numpy as np
import pytest

from mvsam import rooms
from mvsam.data import catalog, lazy
from mvsam.data.catalog import open_data
from mvsam.data.formats import find_format, open_scene
from mvsam.data.streaming.config import DataConfig
from mvsam.data.streaming.stream import SampleStream
from mvsam.errors import InputError
from tests.data.readers.layouts import write_scannet
from tests.synthetic import write_posed_folder


def test_a_scene_folder_is_a_list_of_one(tmp_path):
    write_posed_folder(tmp_path / "room")
    assert [scene.name for scene in open_data(str(tmp_path / "room"))] == ["room"]


def test_a_folder_of_scene_folders_is_all_of_them_sorted(tmp_path):
    for name in ("b", "a", "c"):
        write_posed_folder(tmp_path / name)
    (tmp_path / "notes").mkdir()
    (tmp_path / "readme.txt").write_text("not a scene")
    assert [scene.name for scene in open_data(str(tmp_path))] == ["a", "b", "c"]


def test_a_format_is_that_of_each_scene_in_a_folder(tmp_path):
    write_posed_folder(tmp_path / "room")
    room, scans = open_scene(tmp_path / "room"), tmp_path / "scans"
    for name in ("b", "a"):
        write_scannet([room.frame(index) for index in range(len(room))], scans / name)
    assert [scene.name for scene in open_data(str(scans), "scannet")] == ["a", "b"]
    assert [scene.name for scene in open_data(str(scans / "b"), "scannet")] == ["b"]
    with pytest.raises(InputError, match=r"a/poses"):
        open_data(str(scans), "posed-folder")


def test_a_bad_scene_among_good_ones_is_not_passed_over(tmp_path):
    for name in "ab":
        write_posed_folder(tmp_path / name)
    (tmp_path / "b/intrinsics.txt").unlink()
    with pytest.raises(InputError, match=r"b/intrinsics\.txt"):
        list(open_data(str(tmp_path)))


def test_photos_in_color_do_not_hide_another_format(tmp_path):
    write_posed_folder(tmp_path / "posed", depth=False, labels=False)
    (tmp_path / "posed/transforms.json").touch()
    assert find_format(tmp_path / "posed") == "posed-folder"
    (tmp_path / "posed/poses").rename(tmp_path / "elsewhere")
    assert find_format(tmp_path / "posed") == "nerfstudio"
    (tmp_path / "posed/transforms.json").unlink()
    with pytest.raises(InputError, match="poses"):
        open_data(str(tmp_path / "posed"))


def test_a_path_without_scenes_is_refused(tmp_path):
    with pytest.raises(InputError, match="no scene we know"):
        open_data(str(tmp_path))
    with pytest.raises(InputError, match="no such folder"):
        open_data(str(tmp_path / "nowhere"))


def test_an_empty_path_is_not_the_folder_one_is_in():
    with pytest.raises(InputError, match="path is empty"):
        open_data("")


def test_rooms_are_built_when_asked_for_and_stay_the_same():
    scenes = open_data("rooms:val")
    assert len(scenes) == 100
    part = open_data("rooms:val:3-5")
    assert len(part) == 2
    assert part[0].name == scenes[3].name
    assert part[-1].name == scenes[4].name
    assert [scene.name for scene in part[:]] == [scenes[3].name, scenes[4].name]
    with pytest.raises(IndexError):
        part[2]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("rooms:valid", "one of the splits train, wide, around, val, test"),
        ("rooms:val:5", "expected rooms:SPLIT or rooms:SPLIT:FIRST-END"),
        ("rooms:val:5-5", "the part is empty;"),
        ("rooms:val:90-101", "this split has 100 scenes; end at 100"),
        ("rooms:train", "has no end; name a part, as rooms:train:0-100"),
    ],
)
def test_bad_names_of_rooms_are_explained(name, reason):
    with pytest.raises(InputError, match=reason):
        open_data(name)


def test_rooms_are_rendered_once_where_a_cache_is_given(tmp_path, monkeypatch):
    def rooms_in(cache: str | None):
        catalog._room.cache_clear()
        return open_data("rooms:val:3-4", room_frames=2, room_size=(32, 32), cache=cache)

    truth, first = rooms_in(None)[0], rooms_in(str(tmp_path))[0]
    image = truth.frame(1).image
    (file,) = tmp_path.rglob("*.npz")
    assert file.parent.name == f"v{rooms.VERSION}-32x32-2frames"
    monkeypatch.setattr(sys.modules["mvsam.rooms.scene"], "render", None)  # not to be called again
    for scene in (first, rooms_in(str(tmp_path))[0]):
        assert scene.name == truth.name and scene.views() == truth.views()
        np.testing.assert_array_equal(scene.frame(1).image, image)


def test_rooms_of_two_packs_of_one_name_do_not_share_a_folder(tmp_path):
    folders = set()
    for parent in ("a", "b", "c"):
        pack = tmp_path / parent / "pack"
        pack.mkdir(parents=True)
        (pack / "models.csv").write_text("the same" if parent == "c" else parent)
        (pack / "textures.csv").write_text("the same")
        style = catalog.RoomStyle(cache="rooms", assets=str(pack))
        assert style.cache_folder(4) == style.cache_folder(4)
        folders.add(style.cache_folder(4))
    assert len(folders) == 3


def test_a_list_of_scenes_opens_them_in_its_order(tmp_path):
    for name in ("scene0011_00", "scene0015_00"):
        write_posed_folder(tmp_path / "scans" / name)
    (tmp_path / "scannetv2_val.txt").write_text("scene0015_00\nscene0011_00\n")
    scenes = open_data(str(tmp_path / "scannetv2_val.txt"))
    assert [scene.name for scene in scenes] == ["scene0015_00", "scene0011_00"]


def test_the_scenes_of_a_list_are_opened_when_asked_for_and_few_stay_open(tmp_path, monkeypatch):
    opened = []

    def counted(path, *arguments):
        opened.append(path.name)
        return open_scene(path, *arguments)

    monkeypatch.setattr(catalog, "open_scene", counted)
    monkeypatch.setattr(lazy, "MOST_OPEN", 2)
    names = ["scene0001_00", "scene0002_00", "scene0003_00"]
    for name in names:
        write_posed_folder(tmp_path / name)
    (tmp_path / "scannetv2_val.txt").write_text("\n".join(names))
    scenes = open_data(str(tmp_path / "scannetv2_val.txt"))
    assert len(scenes) == 3 and opened == names[:1]
    first = weakref.ref(scenes[0])
    assert scenes[1] is scenes[1] and scenes[-2].name == names[1]
    assert opened == names[:2] and first() is not None
    assert scenes[2].name == names[2]
    gc.collect()
    assert first() is None
    assert [scene.name for scene in scenes[:2]] == names[:2]
    with pytest.raises(IndexError):
        scenes[3]


def test_rules_and_shards_are_applied_when_asked_for_in_workers_too(tmp_path):
    for name in ("a", "b"):
        write_posed_folder(tmp_path / name)
    config = DataConfig(str(tmp_path), tuples="keyframes", cache=str(tmp_path / "cache"))
    (scenes,) = pickle.loads(pickle.dumps(SampleStream(config, seed=0))).sources
    assert isinstance(scenes, lazy.LazyScenes)
    assert [(scene.name, bool(scene.views())) for scene in scenes] == [("a", True), ("b", True)]


def test_a_missing_official_list_says_where_it_is(tmp_path):
    with pytest.raises(InputError, match=r"github\.com/ScanNet/ScanNet, in Tasks/Benchmark"):
        open_data(str(tmp_path / "scannetv2_train.txt"))
    with pytest.raises(InputError, match="write one with a scene's name a line"):
        open_data(str(tmp_path / "mine.txt"))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "expected one scene's name a line"),
        ("../secret", "expected one scene's name a line"),
        ("..", "expected one scene's name a line"),
        ("scene0011_00 scene0015_00", "2 of its 2 scenes are not beside it"),
    ],
)
def test_a_list_that_cannot_be_followed_is_explained(tmp_path, text, reason):
    (tmp_path / "scannetv2_val.txt").write_text(text)
    with pytest.raises(InputError, match=reason):
        open_data(str(tmp_path / "scannetv2_val.txt"))
