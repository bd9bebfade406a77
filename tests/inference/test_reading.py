import threading
from collections.abc import Iterator

import pytest

from mvsam.errors import InputError
from mvsam.inference.reading import one_ahead


def test_the_next_item_is_made_before_it_is_asked_for_and_no_other():
    made: list[int] = []
    second_is_made = threading.Event()

    def items() -> Iterator[int]:
        for item in range(4):
            assert threading.current_thread() is not threading.main_thread()
            made.append(item)
            if item == 1:
                second_is_made.set()
            yield item

    ahead = one_ahead(items())
    assert next(ahead) == 0
    assert second_is_made.wait(timeout=60)
    assert made == [0, 1]
    assert list(ahead) == [1, 2, 3]


def test_an_error_comes_in_its_place():
    def items() -> Iterator[int]:
        yield 0
        raise InputError("room 1 is damaged")

    ahead = one_ahead(items())
    assert next(ahead) == 0
    with pytest.raises(InputError, match="room 1 is damaged"):
        next(ahead)


def test_no_items_are_none():
    assert list(one_ahead(())) == []
