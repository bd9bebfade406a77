r"""Teaches the context network of `tiny` from first sweeps that are computed once and kept.

    python benchmarks/kept_sweeps.py keep SWEEPS --steps 600 --data "rooms:train:60000-60300"
    python benchmarks/kept_sweeps.py train SWEEPS --steps 3000 --out runs/kept/model.safetensors

All that comes before the network stays as it is, so that a sample's sweep is computed once, and
learning from it takes a sixteenth of a second of a core (docs/log.md). Both follow the run
`tiny_context`. `keep` goes on where it stopped, and several may fill one folder (--seed); `train`
takes what is there while they do.
"""

import argparse
import logging
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from tqdm import tqdm

from mvsam.data.streaming.config import DataConfig
from mvsam.data.streaming.stream import SampleStream, collate_training
from mvsam.errors import InputError
from mvsam.experiments.runs import find_run
from mvsam.loss_terms import depth_at
from mvsam.model import MultiViewSAM
from mvsam.mvs.cascade import regress
from mvsam.precision import autocast
from mvsam.provenance import commit
from mvsam.training.losses import JointLoss
from mvsam.training.optim import OptimizerConfig, make_optimizer
from mvsam.types import DepthPrior, Views
from mvsam.weights import layout_channels_last, load, save

log = logging.getLogger("mvsam")

RUN = find_run("tiny_context")
HALF = torch.float16


class Reached(Exception):
    """The context network was; what follows it is not wanted."""


class Kept:
    """One step's samples as the context network sees them, and the truth at its size."""

    def __init__(self, tensors: dict[str, Tensor]):
        self.tensors = tensors

    @staticmethod
    @torch.inference_mode()
    def of(model: MultiViewSAM, views: Views, depth: Tensor) -> "Kept":
        """Runs the model as far as its context network. depth: of view 0, metres."""
        assert model.context is not None
        seen: list[Any] = []

        def stop(_: nn.Module, inputs: Sequence[Any]) -> NoReturn:
            seen.extend(inputs)
            raise Reached

        hook = model.context.register_forward_pre_hook(stop)
        try:
            with autocast("cpu"):
                model(views)
        except Reached:
            pass
        finally:
            hook.remove()
        scores, _, features, semantic, prior, _ = seen
        tensors = {
            "scores": (scores - scores.amax(dim=1, keepdim=True)).clamp(min=-60).to(HALF),
            "features": features.to(HALF),
            "semantic": nn.functional.avg_pool2d(semantic.float(), 4).to(HALF),
            "prior": torch.stack([prior.log_median, prior.log_precision], dim=1).to(HALF),
            "intrinsics": views.intrinsics,
            "world_from_cam": views.world_from_cam,
            "depth_range": views.depth_range,
            "size": torch.tensor([views.height, views.width]),
            "depth": depth_at(depth, scores.shape[-2:]),
        }
        return Kept({name: value.contiguous() for name, value in tensors.items()})

    def mirrored(self) -> "Kept":
        """The same as in a mirror; nearly, for features of mirrored photos differ a little."""
        flipped = {
            name: self.tensors[name].flip(-1)
            for name in ("scores", "features", "semantic", "prior", "depth")
        }
        intrinsics = self.tensors["intrinsics"].clone()
        intrinsics[..., 0, 2] = self.tensors["size"][1] - intrinsics[..., 0, 2]
        mirror = torch.diag(intrinsics.new_tensor([-1, 1, 1, 1]))
        poses = mirror @ self.tensors["world_from_cam"] @ mirror
        return Kept(self.tensors | flipped | {"intrinsics": intrinsics, "world_from_cam": poses})

    @property
    def views(self) -> Views:
        """Cameras without pictures."""
        height, width = self.tensors["size"].tolist()
        poses = self.tensors["world_from_cam"]
        return Views(
            poses.new_zeros(()).expand(*poses.shape[:2], 3, height, width),
            self.tensors["intrinsics"],
            poses,
            self.tensors["depth_range"],
        )

    def inputs(self, hypotheses: Tensor) -> tuple[Any, ...]:
        """What `ContextNetwork.forward` takes."""
        median, precision = self.tensors["prior"].float().unbind(dim=1)
        semantic = self.tensors["semantic"].float()
        return (
            self.tensors["scores"].float(),
            hypotheses,
            self.tensors["features"].float(),
            nn.functional.interpolate(semantic, scale_factor=4),  # to be averaged there
            DepthPrior(median, precision),
            self.views,
        )


def keep(folder: Path, steps: int, seed: int, data: DataConfig) -> None:
    """Fills the folder with the first `steps` batches of the stream, but for those it has."""
    folder.mkdir(parents=True, exist_ok=True)
    model, batch = opened("tiny"), RUN.train.batch_size
    stream = SampleStream(data, seed, batch)
    for step in tqdm(range(steps), unit="step"):
        path = folder / f"{seed}-{step:06d}.safetensors"
        if path.exists():
            continue
        sample = collate_training([stream[step * batch + item] for item in range(batch)])
        kept = Kept.of(model, sample.views, sample.targets[0].depth)
        part = path.with_suffix(".part")
        save_file(kept.tensors, part)
        part.rename(path)


def train(folder: Path, init: str, optimizer: OptimizerConfig, seed: int, out: Path) -> None:
    """Writes the model of `init` with a context network that learned from the folder's sweeps."""
    assert isinstance(RUN.loss, JointLoss)
    loss_of = replace(RUN.loss, stage_weights=RUN.loss.stage_weights[:1])
    model = opened(init)
    assert model.cascade is not None and model.context is not None
    learner = layout_channels_last(model.context).train()
    updates, schedule = make_optimizer(learner, optimizer)
    dice = np.random.default_rng(seed)
    paths, means, began = kept_in(folder), np.zeros(2), time.monotonic()
    for step in tqdm(range(optimizer.steps), unit="step"):
        if step % 100 == 0:
            paths = kept_in(folder)
        kept = Kept(load_file(paths[dice.integers(len(paths))]))
        kept = kept.mirrored() if dice.random() < 0.5 else kept
        depth, views = kept.tensors["depth"], kept.views
        hypotheses = model.cascade.hypotheses(0, [], depth.shape[-2:], views)
        with autocast("cpu"):
            scores = learner(*kept.inputs(hypotheses))
        before = regress(kept.tensors["scores"].float(), hypotheses)
        with torch.no_grad():
            alone = loss_of.depth([before], depth, views.depth_range)
        loss = loss_of.depth([regress(scores, hypotheses)], depth, views.depth_range)
        updates.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(learner.parameters(), optimizer.gradient_clip or torch.inf)
        updates.step()
        schedule.step()
        means += [alone.item(), loss.item()]
        if (step + 1) % 100 == 0:
            per_second = (step + 1) / (time.monotonic() - began)
            log.info(
                "step %d: loss %.4f, of the sweep alone %.4f; %d steps kept, %.2f a second",
                *(step + 1, *(means / 100)[::-1], len(paths), per_second),
            )
            means[:] = 0
        if (step + 1) % 500 == 0 or step + 1 == optimizer.steps:
            write(model, out, init, step + 1)


def kept_in(folder: Path) -> list[Path]:
    """Files of `keep`; InputError where there is none."""
    paths = sorted(folder.glob("*.safetensors"))
    if not paths:
        raise InputError(f"{folder} holds no sweeps: run `kept_sweeps.py keep {folder}` first.")
    return paths


def opened(name: str) -> MultiViewSAM:
    model = load(name)
    assert isinstance(model, MultiViewSAM)
    return model.eval()


def write(model: MultiViewSAM, out: Path, init: str, steps: int) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    info = model.info
    save(
        model,
        out,
        name=info.model,
        depth_range=info.depth_range,
        classes=info.classes,
        palette=info.palette,
        training={"run": "kept_sweeps", "steps": steps, "commit": commit(), "began_with": init},
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    commands = parser.add_subparsers(dest="command", required=True)
    keeping = commands.add_parser("keep", help="compute first sweeps and keep them")
    keeping.add_argument("folder", type=Path)
    keeping.add_argument("--steps", type=int, default=1000, help="of so many samples as the run's")
    keeping.add_argument("--data", default=RUN.data.train, help="as --data.train of mvsam train")
    keeping.add_argument("--pose-noise", type=float, nargs=2, default=RUN.data.pose_noise)
    keeping.add_argument("--cache", default=RUN.data.cache, help="folder for rendered rooms")
    keeping.add_argument("--seed", type=int, default=RUN.train.seed)
    learning = commands.add_parser("train", help="learn from what was kept")
    learning.add_argument("folder", type=Path)
    learning.add_argument("--init", default="tiny", help="name, weights file or hub id")
    learning.add_argument("--steps", type=int, default=RUN.optimizer.steps)
    learning.add_argument("--lr", type=float, default=RUN.optimizer.lr)
    learning.add_argument("--seed", type=int, default=RUN.train.seed)
    learning.add_argument("--out", type=Path, required=True, help="weights file to write")
    given = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    torch.set_num_threads(1)
    if given.command == "keep":
        noise = (given.pose_noise[0], given.pose_noise[1])
        data = replace(RUN.data, train=given.data, pose_noise=noise, cache=given.cache)
        keep(given.folder, given.steps, given.seed, data)
    else:
        optimizer = replace(RUN.optimizer, steps=given.steps, lr=given.lr)
        train(given.folder, given.init, optimizer, given.seed, given.out)


if __name__ == "__main__":
    main()
