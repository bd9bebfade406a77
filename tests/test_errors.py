"""Sentences for users."""

from mvsam.errors import counted


def test_one_is_singular():
    assert [counted(n, "photo") for n in (0, 1, 2)] == ["0 photos", "1 photo", "2 photos"]
