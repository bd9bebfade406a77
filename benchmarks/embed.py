"""Puts a run's weights into the package, in half precision.

python benchmarks/embed.py runs/tiny --name tiny
python benchmarks/embed.py runs/tiny --name tiny --average runs/tiny_semantic_full --share 0.75
"""

import argparse
from pathlib import Path

import torch
from torch import nn

from mvsam.weights import ASSETS, load, save


@torch.no_grad()
def average_with(model: nn.Module, other: nn.Module, share: float) -> None:
    """What both have becomes its mean, `share` of it the other's (Wortsman et al. 2022)."""
    theirs = other.state_dict()
    for name, value in model.state_dict().items():
        if value.is_floating_point() and name in theirs:
            value.lerp_(theirs[name], share)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("run", help="folder of a finished run, or a checkpoint")
    parser.add_argument("--name", required=True, help="under which mvsam.load finds it")
    parser.add_argument("--average", help="other weights; of what both have the mean is embedded")
    parser.add_argument("--share", type=float, default=0.5, help="of the other weights in the mean")
    arguments = parser.parse_args()
    model = load(arguments.run)
    info = model.info
    training = dict(info.training)
    if arguments.average:
        other = load(arguments.average)
        average_with(model, other, arguments.share)
        training["averaged_with"] = [other.weights_hash, arguments.share]
    target = ASSETS / f"{arguments.name}.safetensors"
    save(
        model,
        target,
        name=info.model,
        depth_range=info.depth_range,
        training=training,
        half=True,
        classes=info.classes,
        palette=info.palette,
    )
    print(f"{target}: {Path(target).stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
