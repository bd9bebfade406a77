from pathlib import Path

import pytest
import torch

from mvsam.encoders.feature_cache import FeatureCache
from mvsam.encoders.sam import SamEncoder
from mvsam.errors import InputError
from tests.encoders.sam_twin import randomize
from tests.small import SIDE, small_backbone


def encoder(tuned_blocks: int | None = 0, seed: int = 0) -> SamEncoder:
    torch.manual_seed(seed)
    made = SamEncoder(small_backbone(), input_side=SIDE, tuned_blocks=tuned_blocks)
    randomize(made)
    return made.eval()


def pictures(count: int = 2, seed: int = 0) -> torch.Tensor:
    return torch.rand(count, 3, 32, 64, generator=torch.Generator().manual_seed(seed))


def counts(cache: FeatureCache) -> tuple[int, int]:
    return cache.hits, cache.misses


@pytest.mark.parametrize("tuned_blocks", [0, 1, 3])
def test_features_from_disk_are_those_computed_to_float16(tmp_path: Path, tuned_blocks: int):
    expected = encoder(tuned_blocks)(pictures())
    first = encoder(tuned_blocks)
    cache = first.cache_frozen_part(tmp_path)
    computed = first(pictures())
    assert counts(cache) == (0, 2)
    second = encoder(tuned_blocks)
    cache = second.cache_frozen_part(tmp_path)
    read = second(pictures())
    assert counts(cache) == (2, 0)
    torch.testing.assert_close(read, computed, atol=0, rtol=0)
    # Tokens of up to 5 in steps of 2^-8 at most, through the tuned blocks.
    torch.testing.assert_close(read, expected, atol=2e-2, rtol=0)


def test_only_pictures_not_seen_before_are_computed(tmp_path: Path):
    made = encoder()
    cache = made.cache_frozen_part(tmp_path)
    made(pictures(1))
    expected = encoder()(pictures(3))
    got = made(pictures(3))
    assert torch.equal(pictures(3)[:1], pictures(1))
    assert counts(cache) == (1, 3)
    torch.testing.assert_close(got, expected, atol=2e-2, rtol=0)


def test_what_is_tuned_still_learns_and_what_is_frozen_does_not(tmp_path: Path):
    made = encoder(1)
    made.cache_frozen_part(tmp_path)
    for _ in range(2):  # computed, then read
        made.zero_grad()
        made(pictures()).square().sum().backward()
        learned = {name for name, p in made.named_parameters() if p.grad is not None}
        assert learned == {name for name, p in made.named_parameters() if p.requires_grad}


def changed(made: SamEncoder) -> SamEncoder:
    with torch.no_grad():
        next(iter(made.backbone.blocks.parameters()))[0] += 1
    return made


@pytest.mark.parametrize("other", [changed(encoder()), encoder(1)], ids=["weights", "tuned blocks"])
def test_another_frozen_part_finds_nothing(tmp_path: Path, other: SamEncoder):
    made = encoder()
    made.cache_frozen_part(tmp_path)
    made(pictures())
    cache = other.cache_frozen_part(tmp_path)
    other(pictures())
    assert counts(cache) == (0, 2)


def test_another_size_or_arithmetic_finds_nothing(tmp_path: Path):
    made = encoder()
    cache = made.cache_frozen_part(tmp_path)
    with torch.no_grad():
        made(pictures())
        made(pictures().reshape(2, 3, 64, 32))
        with torch.autocast("cpu", torch.bfloat16):
            made(pictures())
    assert counts(cache) == (0, 6)


def test_weights_loaded_before_the_first_picture_count(tmp_path: Path):
    made, other = encoder(), encoder(seed=1)
    made.cache_frozen_part(tmp_path)
    made(pictures())
    cache = other.cache_frozen_part(tmp_path)
    other.load_state_dict(made.state_dict())  # as a resumed training does
    other(pictures())
    assert counts(cache) == (2, 0)


@pytest.mark.parametrize("damage", ["cut short", "a bit flipped", "empty"])
def test_a_damaged_file_is_made_anew(tmp_path: Path, damage: str):
    made = encoder()
    cache = made.cache_frozen_part(tmp_path)
    expected = made(pictures(1))
    (path,) = tmp_path.rglob("*.npz")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes({"cut short": content[:500], "empty": b""}.get(damage, bytes(content)))
    torch.testing.assert_close(made(pictures(1)), expected, atol=0, rtol=0)
    made(pictures(1))
    assert counts(cache) == (1, 2)


def test_an_encoder_that_learns_as_a_whole_has_nothing_to_keep(tmp_path: Path):
    with pytest.raises(InputError, match="no frozen features to keep"):
        encoder(None).cache_frozen_part(tmp_path)


def test_features_beyond_float16_are_refused(tmp_path: Path):
    cache = FeatureCache(tmp_path, lambda: "")
    with pytest.raises(InputError, match="float16"):
        cache(pictures(), lambda images: 1e6 * images)
