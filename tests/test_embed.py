"""`benchmarks/embed.py`: which of several weights end up in the file, and how much of each."""

import importlib.util
import sys
from pathlib import Path

import pytest
import torch

from mvsam.build import build
from mvsam.errors import InputError
from mvsam.weights import load, read_tensors, save

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "embed.py"


@pytest.fixture(scope="module")
def embed():
    spec = importlib.util.spec_from_file_location("embed", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> dict[str, Path]:
    """Of three halves of `tiny`, two of them of the same parts."""
    folder, found = tmp_path_factory.mktemp("weights"), {}
    for seed, (name, model) in enumerate(
        {"a": "tiny_semantic", "b": "tiny_semantic", "depth": "tiny_mvs_sam"}.items()
    ):
        torch.manual_seed(seed)
        network = build(model)
        network.input_size = (96, 64)
        found[name] = folder / f"{name}.safetensors"
        save(network, found[name], model, training={"run": name})
    return found


def run(embed, monkeypatch, *arguments) -> None:
    monkeypatch.setattr(sys, "argv", ["embed.py", *map(str, arguments)])
    embed.main()


def test_shares_are_those_of_the_later_weights_and_sizes_are_kept(
    embed, weights, tmp_path, monkeypatch
):
    out = tmp_path / "mean.safetensors"
    run(embed, monkeypatch, weights["a"], f"{weights['b']}=0.25", "--out", out)
    mean, a, b = (load(str(path)) for path in (out, weights["a"], weights["b"]))
    assert mean.input_size == (96, 64) and mean.info.model == "tiny_semantic"
    assert mean.info.training["run"] == "a", "the first weights' record, and what was mixed in"
    assert [share for _, share in mean.info.training["made_of"]] == [1.0, 0.25]
    theirs = b.state_dict()
    for name, value in a.state_dict().items():
        if value.is_floating_point():
            expected = 0.75 * value + 0.25 * theirs[name]
            torch.testing.assert_close(mean.state_dict()[name], expected, atol=1e-5, rtol=1e-4)


def test_what_no_earlier_weights_have_is_taken_whole(embed, weights, tmp_path, monkeypatch):
    out = tmp_path / "tiny_base.safetensors"
    run(
        embed,
        monkeypatch,
        weights["a"],
        f"{weights['depth']}=0.5",
        *("--model", "tiny_base", "--out", out),
    )
    whole, depth = load(str(out)).state_dict(), load(str(weights["depth"])).state_dict()
    new = [name for name in depth if name.startswith(("cascade", "geometry_encoder", "bridge"))]
    assert new
    for name in new:
        torch.testing.assert_close(whole[name], depth[name], atol=1e-5, rtol=1e-4)


def test_a_part_that_the_first_weights_are_too_old_for_comes_from_later_ones(
    embed, tmp_path, monkeypatch
):
    old, new, out = (tmp_path / f"{name}.safetensors" for name in ("old", "new", "out"))
    for seed, path in enumerate((old, new)):
        torch.manual_seed(seed)
        network = build("tiny")
        if path == old:
            network.context = None  # pyright: ignore[reportArgumentType]
        save(network, path, "tiny", training={"run": path.stem})
    run(embed, monkeypatch, old, new, "--parts", "context", "--out", out)
    made, first, second = (read_tensors(path) for path in (out, old, new))
    for name, value in made.items():
        assert torch.equal(value, (second if name.startswith("context.") else first)[name]), name
    with pytest.raises(InputError, match="none of the weights have context"):
        run(embed, monkeypatch, old, "--model", "tiny", "--out", out)


def test_of_later_weights_the_named_parts_alone_are_taken(embed, weights, tmp_path, monkeypatch):
    out = tmp_path / "parts.safetensors"
    run(embed, monkeypatch, weights["a"], weights["b"], "--parts", "decoder", "--out", out)
    first, second, made = (load(str(path)) for path in (weights["a"], weights["b"], out))
    for name, value in made.state_dict().items():
        source = second if name.startswith("decoder.") else first
        assert torch.equal(value, source.state_dict()[name]), name
    assert made.info.training["parts_of_later"] == ["decoder"]


@pytest.mark.parametrize(("later", "part"), [((), "decoder"), (("b",), "decoders")])
def test_parts_that_nothing_has_are_refused(
    embed, weights, tmp_path, monkeypatch, later: tuple[str, ...], part: str
):
    files = [weights["a"], *(weights[name] for name in later)]
    with pytest.raises(InputError, match="--parts"):
        run(embed, monkeypatch, *files, "--parts", part, "--out", tmp_path / "made.safetensors")


@pytest.mark.parametrize(("first", "later"), [("=0.5", ""), ("", "=1.5"), ("", "=0")])
def test_a_share_that_says_nothing_is_refused(
    embed, weights, tmp_path, monkeypatch, first: str, later: str
):
    parts = (f"{weights['a']}{first}", f"{weights['b']}{later}")
    with pytest.raises(InputError, match=r"comes first|between 0 and 1"):
        run(embed, monkeypatch, *parts, "--out", tmp_path / "mean.safetensors")


def test_weights_of_another_size_are_refused(embed, weights, tmp_path, monkeypatch):
    other = build("tiny_semantic")
    other.input_size = (128, 96)
    path = tmp_path / "other.safetensors"
    save(other, path, "tiny_semantic")
    with pytest.raises(InputError, match="differ in input_size"):
        run(embed, monkeypatch, weights["a"], path, "--out", tmp_path / "mean.safetensors")


def test_a_part_that_none_has_is_missed(embed, weights, tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"none of the weights have .* of tiny"):
        run(
            embed,
            monkeypatch,
            weights["a"],
            *("--model", "tiny", "--out", tmp_path / "tiny.safetensors"),
        )
