"""Puts a run's weights into the package, in half precision.

python benchmarks/embed.py runs/tiny --name tiny
"""

import argparse
from pathlib import Path

from mvsam.weights import ASSETS, load, save


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("run", help="folder of a finished run, or a checkpoint")
    parser.add_argument("--name", required=True, help="under which mvsam.load finds it")
    arguments = parser.parse_args()
    model = load(arguments.run)
    info = model.info
    target = ASSETS / f"{arguments.name}.safetensors"
    save(
        model,
        target,
        name=info.model,
        depth_range=info.depth_range,
        training=info.training,
        half=True,
        classes=info.classes,
        palette=info.palette,
    )
    print(f"{target}: {Path(target).stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
