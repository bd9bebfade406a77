import errno
import resource
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import mvsam.files
from mvsam.errors import InputError
from mvsam.files import (
    DiskFullError,
    remove_partial_files,
    writable_folder,
    write_json,
    write_whole,
)


@pytest.mark.parametrize("failure", [KeyboardInterrupt(), ValueError("no")])
def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path, failure):
    path = tmp_path / "map.png"
    path.write_text("old")

    def save(file):
        file.write(b"half of the new")
        raise failure

    with pytest.raises(type(failure)):
        write_whole(path, save)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_names_the_file(tmp_path: Path, monkeypatch):
    def no_room(source, target):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(mvsam.files.os, "replace", no_room)
    with pytest.raises(DiskFullError, match=r"disk is full: no room for .*map\.png; free some"):
        write_json(tmp_path / "deep/map.png", {})
    assert list((tmp_path / "deep").iterdir()) == []


def test_a_write_cut_short_is_noticed(tmp_path: Path):
    noise = np.random.default_rng(0).integers(0, 256, (128, 128, 3)).astype(np.uint8)

    def save(file):
        Image.fromarray(noise).save(file, format="JPEG")

    save(whole := BytesIO())
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    # As a disk with ten bytes too little room.
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(whole.getbuffer()) - 10, limits[1]))
    try:
        with pytest.raises(OSError):
            write_whole(tmp_path / "map.jpg", save)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


def test_other_system_errors_stay_what_they_are(tmp_path: Path):
    (tmp_path / "map.png").mkdir()
    with pytest.raises(IsADirectoryError):
        write_json(tmp_path / "map.png", {})


def test_only_fragments_are_cleaned_up(tmp_path: Path):
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth/.0001.png.0123abcd.part").touch()
    others = {"0001.png", "notes.part", ".download.part"}
    for name in others:
        (tmp_path / "depth" / name).touch()
    remove_partial_files(tmp_path)
    assert {p.name for p in tmp_path.rglob("*") if p.is_file()} == others


def test_a_folder_that_refuses_files_is_named(tmp_path: Path, monkeypatch):
    def refuse(self):
        raise PermissionError(errno.EACCES, "Permission denied")

    assert writable_folder(tmp_path / "new/deep").is_dir()
    monkeypatch.setattr(Path, "touch", refuse)  # root may write anywhere, so permissions won't do
    with pytest.raises(InputError, match=r"not writable \(Permission denied\): choose another"):
        writable_folder(tmp_path / "new")


def test_processes_may_try_a_folder_at_once(tmp_path: Path):
    seen = []

    def touched_by_another(self):
        seen.append(self.name)
        writable_folder(tmp_path) if len(seen) == 1 else None

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "touch", touched_by_another)
        writable_folder(tmp_path)
    assert len(set(seen)) == 2


def test_two_writers_of_one_file_do_not_meet(tmp_path: Path):
    path = tmp_path / "map.txt"

    def save(file):
        """Another process writes the same file before we are done."""
        write_whole(path, lambda other: other.write(b"theirs"))
        file.write(b"ours")

    partial = []
    replace = mvsam.files.os.replace
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mvsam.files.os, "replace", lambda a, b: (partial.append(a), replace(a, b)))
        write_whole(path, save)
    assert path.read_bytes() == b"ours"
    assert len(set(partial)) == 2
