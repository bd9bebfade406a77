from pathlib import Path

import pytest

from mvsam.data.streaming.name_lists import NAME_LISTS, read_names
from mvsam.errors import InputError


def test_lists_of_names_are_read_from_the_package_and_from_files(tmp_path: Path):
    (tmp_path / "names.txt").write_text("a b  # two\n\n# none\nc\n")
    assert read_names(str(tmp_path / "names.txt")) == ["a", "b", "c"]
    with pytest.raises(InputError, match="cannot be read as a list of names"):
        read_names("nyuv2_helld_out")


def test_a_tenth_of_nyuv2_is_kept_for_scores():
    held_out, posed = (read_names(name) for name in NAME_LISTS)
    assert len(set(held_out)) == 83 and len(set(posed)) == 59 + 32
    assert all(1 <= int(name) <= 1449 and len(name) == 4 for name in held_out + posed)
