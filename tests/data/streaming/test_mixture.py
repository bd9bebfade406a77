"""Sources of training data in given shares."""

import pytest

from mvsam.data.streaming.mixture import Mixture, Source, parse_sources
from mvsam.errors import InputError


def test_sources_are_written_as_weights_and_names():
    assert parse_sources("rooms:train:0-5") == [Source(1.0, "rooms:train:0-5")]
    assert parse_sources("0.7 @ rooms:train:0-5 + 3e-1 @ my scans/a+b@c") == [
        Source(0.7, "rooms:train:0-5"),
        Source(0.3, "my scans/a+b@c"),
    ]


@pytest.mark.parametrize(
    "text", ["0 @ a", "-1 @ a + b", "nan @ a", "inf @ a", "two @ a", "a + ", ""]
)
def test_a_weight_that_is_none_is_refused(text: str):
    with pytest.raises(InputError, match="weight above 0"):
        parse_sources(text)


def test_every_block_of_a_hundred_has_the_shares():
    mixture = Mixture([6.0, 3.0, 1.0], seed=5)
    for block in range(3):
        drawn = [mixture(n)[0] for n in range(100 * block, 100 * (block + 1))]
        assert [drawn.count(source) for source in range(3)] == [60, 30, 10]


@pytest.mark.parametrize(
    ("weights", "quotas"),
    [
        ([1.0], (100,)),
        ([1.0, 1.0, 1.0], (34, 33, 33)),
        ([1e6, 1.0, 1.0], (98, 1, 1)),
        ([1.0] * 100, None),
    ],
)
def test_shares_are_whole_and_none_is_empty(weights: list[float], quotas: tuple | None):
    assert Mixture(weights, seed=0).quotas == (quotas or (1,) * 100)


def test_each_source_is_read_from_its_start_without_gaps():
    mixture = Mixture([0.7, 0.3], seed=1)
    places: dict[int, list[int]] = {0: [], 1: []}
    for n in range(250):
        source, place = mixture(n)
        places[source].append(place)
    assert all(seen == list(range(len(seen))) for seen in places.values())


def test_a_place_depends_on_seed_and_number_alone():
    forward = [Mixture([2.0, 1.0], seed=3)(n) for n in range(50)]
    assert [Mixture([2.0, 1.0], seed=3)(n) for n in reversed(range(50))][::-1] == forward
    assert [Mixture([2.0, 1.0], seed=4)(n) for n in range(50)] != forward


def test_too_many_sources_are_refused():
    with pytest.raises(InputError, match="at most 100"):
        Mixture([1.0] * 101, seed=0)
