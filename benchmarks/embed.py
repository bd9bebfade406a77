r"""Puts the weights of one run, or of several, into the package, in half precision.

    python benchmarks/embed.py runs/tiny_joint --name tiny
    python benchmarks/embed.py runs/tiny_joint runs/tiny_semantic_full=0.5 --model tiny --name tiny
    python benchmarks/embed.py tiny runs/tiny_sweeps \
        --parts cascade geometry_encoder bridge --name tiny

Later weights replace earlier ones, with --parts in these parts alone; with =SHARE what both have
becomes their mean, that share of it the later one's (Wortsman et al. 2022). What belongs to no part
of the model is left out; the first weights may lack a part that later ones bring.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor, nn

from mvsam.build import build
from mvsam.errors import InputError
from mvsam.weights import ASSETS, WeightsInfo, file_hash, locate, read_info, read_tensors, save


class Opened(NamedTuple):
    """A file of weights, whatever model it fits."""

    info: WeightsInfo
    tensors: dict[str, Tensor]
    hash: str

    @staticmethod
    def of(name: str) -> "Opened":
        path, page = locate(name)
        return Opened(read_info(page), read_tensors(path), file_hash(path))


class Part(NamedTuple):
    """Weights, and how much of the mean is theirs."""

    weights: str
    share: float

    @staticmethod
    def parse(text: str) -> "Part":
        weights, _, share = text.partition("=")
        return Part(weights, float(share or 1))


@torch.no_grad()
def mix_in(
    model: nn.Module,
    tensors: dict[str, Tensor],
    share: float,
    fresh: set[str],
    parts: Sequence[str],
) -> None:
    """What both have becomes its mean, `share` of it theirs; what is `fresh`, all of it.

    parts: names of modules that alone take part; all where none is named.
    """
    theirs = {
        name: value
        for name, value in tensors.items()
        if not parts or any(name.startswith(f"{part}.") for part in parts)
    }
    for name, value in model.state_dict().items():
        if name in theirs and value.is_floating_point() and name not in fresh:
            value.lerp_(theirs[name], share)
        elif name in theirs:
            value.copy_(theirs[name])
    fresh.difference_update(theirs)


def check_shares(parts: Sequence[Part]) -> None:
    """InputError where a share says nothing: of the first weights, or none of the later ones'."""
    if parts[0].share != 1:
        raise InputError(f"{parts[0].weights} comes first: there is nothing to mix it into.")
    for part in parts:
        if not 0 < part.share <= 1:
            raise InputError(f"{part.weights}={part.share:g}: a share lies between 0 and 1.")


def check_pages(pages: Sequence[WeightsInfo]) -> None:
    """InputError where weights are for other classes, depths or sizes than the last ones."""
    for name in ("classes", "depth_range", "input_size", "semantic_size"):
        if len({str(getattr(page, name)) for page in pages}) > 1:
            raise InputError(f"the weights differ in {name}: they cannot become one file.")


def check_parts(parts: Sequence[str], later: Sequence[Opened]) -> None:
    """InputError for a part that later weights lack, or without later weights."""
    if parts and not later:
        raise InputError("--parts names what is taken of later weights: give some.")
    for part in parts:
        if not all(any(n.startswith(f"{part}.") for n in each.tensors) for each in later):
            raise InputError(f"--parts {part}: not all of the later weights have such a module.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("weights", nargs="+", type=Part.parse, metavar="WEIGHTS[=SHARE]")
    parser.add_argument(
        "--model",
        help="which of `mvsam models`; that of the last weights, with --parts of the first",
    )
    parser.add_argument("--parts", nargs="+", default=[], help="modules taken of later weights")
    place = parser.add_mutually_exclusive_group(required=True)
    place.add_argument("--name", help="under which mvsam.load finds it")
    place.add_argument("--out", type=Path, help="another file, in full precision")
    arguments = parser.parse_args()
    check_shares(arguments.weights)
    loaded = [Opened.of(part.weights) for part in arguments.weights]
    info = (loaded[0] if arguments.parts else loaded[-1]).info
    check_pages([model.info for model in loaded])
    name = arguments.model or info.model
    model = build(name, info.num_classes)
    model.input_size, model.semantic_size = info.input_size, info.semantic_size
    check_parts(arguments.parts, loaded[1:])
    fresh = set(model.state_dict())
    for index, (part, other) in enumerate(zip(arguments.weights, loaded, strict=True)):
        mix_in(model, other.tensors, part.share, fresh, arguments.parts if index else ())
    if fresh:
        raise InputError(f"none of the weights have {', '.join(sorted(fresh)[:5])} of {name}.")
    shares = [part.share for part in arguments.weights]
    made_of = [[each.hash, share] for each, share in zip(loaded, shares, strict=True)]
    target = arguments.out or ASSETS / f"{arguments.name}.safetensors"
    target.parent.mkdir(parents=True, exist_ok=True)
    save(
        model,
        target,
        name=name,
        depth_range=info.depth_range,
        training=loaded[0].info.training | _mixture(made_of, arguments.parts),
        half=arguments.out is None,
        classes=info.classes,
        palette=info.palette,
    )
    print(f"{target}: {target.stat().st_size / 1e6:.1f} MB")


def _mixture(made_of: list, parts: Sequence[str]) -> dict:
    """What the file says of itself, for more than one file of weights."""
    if len(made_of) < 2:
        return {}
    return {"made_of": made_of} | ({"parts_of_later": list(parts)} if parts else {})


if __name__ == "__main__":
    main()
