"""Loss curves of our training and of the textbook's, from equal weights on equal samples.

    python benchmarks/loss_curves.py \
        --out results/loss_curves.json --picture docs/pictures/loss_curves.png

Three runs of each model, half-size pictures: `textbook` in float32; `ours`, in the precision the
device is best at, from the same weights; `chance`, the textbook again from other weights, which
says how far apart such curves lie anyway. Killed, the same command goes on where it stopped.
"""

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from rich.progress import Progress

from mvsam.apps.bench.cases import Case
from mvsam.apps.bench.forms import FORMS
from mvsam.data.streaming.config import DataConfig
from mvsam.data.streaming.stream import SampleStream, collate_training
from mvsam.files import write_json, write_whole
from mvsam.precision import autocast, resolve
from mvsam.provenance import provenance
from mvsam.training.losses import JointLoss
from mvsam.training.optim import OptimizerConfig, make_optimizer

SAVE_EVERY = 20
"""Steps that a kill can cost."""
WINDOW = 50
"""Steps a curve is averaged over."""


@dataclass(frozen=True)
class Settings:
    """What the runs share."""

    steps: int
    batch_size: int
    data: DataConfig
    optimizer: OptimizerConfig
    folder: Path


class Run:
    """One training, kept in a file of its own after every `SAVE_EVERY` steps."""

    def __init__(self, name: str, case: Case, seed: int, settings: Settings):
        self.settings, self.case, self.losses = settings, case, []
        length = f"{settings.steps}x{settings.batch_size}"
        self.path = settings.folder / f"{case.model}-{name}-{length}.pt"
        torch.manual_seed(seed)
        self.model = FORMS[case.form].prepare(case).to(case.device)
        self.optimizer, self.schedule = make_optimizer(self.model, settings.optimizer)
        if self.path.exists():
            self.restore(torch.load(self.path, map_location=case.device, weights_only=True))

    def finish(self, samples: SampleStream, progress: Progress) -> list[float]:
        """Trains on from where it stands; the loss of every step."""
        total, size = self.settings.steps, self.settings.batch_size
        task = progress.add_task(self.path.stem, total=total, completed=len(self.losses))
        for step in range(len(self.losses), total):
            batch = [samples[n] for n in range(size * step, size * (step + 1))]
            self.losses.append(self.step(batch))
            progress.update(task, completed=step + 1)
            if (step + 1) % SAVE_EVERY == 0 or step + 1 == total:
                write_whole(self.path, lambda file: torch.save(self.state(), file))
        return self.losses

    def step(self, samples: Sequence) -> float:
        views, (targets,), _ = collate_training(samples)
        views, targets = views.to(self.case.device), targets.to(self.case.device)
        with autocast(self.case.device, self.case.precision):
            loss = JointLoss()(self.model(views), targets, views.depth_range)["loss"]
        self.optimizer.zero_grad()
        loss.backward()
        if (largest := self.settings.optimizer.gradient_clip) is not None:
            torch.nn.utils.clip_grad_norm_(self.model.parameters(), largest)
        self.optimizer.step()
        self.schedule.step()
        return loss.item()

    def state(self) -> dict:
        parts = (self.model, self.optimizer, self.schedule)
        return {"losses": self.losses, "parts": [part.state_dict() for part in parts]}

    def restore(self, state: dict) -> None:
        self.losses = state["losses"]
        parts = (self.model, self.optimizer, self.schedule)
        for part, content in zip(parts, state["parts"], strict=True):
            part.load_state_dict(content)


def smooth(losses: Sequence[float], window: int = WINDOW) -> np.ndarray:
    """Logarithm of the running mean."""
    window = min(window, len(losses))
    return np.log(np.convolve(losses, np.full(window, 1 / window), mode="valid"))


def distance(first: Sequence[float], second: Sequence[float]) -> float:
    """Root mean square of how far two curves are apart in their second half, as a share."""
    apart = smooth(first) - smooth(second)
    return float(np.sqrt(np.mean(apart[len(apart) // 2 :] ** 2)))


def compare(model: str, settings: Settings, samples: SampleStream, progress: Progress) -> dict:
    """The three curves of a model, and whether ours is as near to the textbook's as chance is."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    ours = Case(model, work="train", precision=resolve("auto", device), device=device)
    textbook = replace(ours, form="textbook", precision="float32")
    plan = {"textbook": (textbook, 0), "ours": (ours, 0), "chance": (textbook, 1)}
    curves = {
        name: Run(name, case, seed, settings).finish(samples, progress)
        for name, (case, seed) in plan.items()
    }
    apart = distance(curves["textbook"], curves["ours"])
    by_chance = distance(curves["textbook"], curves["chance"])
    return {
        "precision": ours.precision,
        "ours_from_textbook": apart,
        "chance_from_textbook": by_chance,
        "within_noise": apart <= by_chance,
        "losses": curves,
    }


def draw(models: dict[str, dict], path: Path) -> None:
    figure, row = plt.subplots(
        1, len(models), figsize=(4.5 * len(models), 3.2), layout="constrained", squeeze=False
    )
    for axes, (model, found) in zip(row[0], models.items(), strict=True):
        for name, losses in found["losses"].items():
            curve = np.exp(smooth(losses))
            label = f"ours, {found['precision']}" if name == "ours" else name
            axes.semilogy(len(losses) - len(curve) + 1 + np.arange(len(curve)), curve, label=label)
        axes.set_title(model)
        axes.set_xlabel("step")
        axes.grid(alpha=0.3, which="both")
    row[0, 0].set_ylabel(f"loss, mean over {WINDOW} steps")
    row[0, 0].legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--models", nargs="+", default=["cas_mvsnet", "tiny"])
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--batch-size", type=int, default=2, help="samples a step")
    parser.add_argument("--data", default="rooms:train:0-200", help="scenes to train on")
    parser.add_argument("--cache", default="cache/rooms", help="folder for rendered rooms")
    parser.add_argument(
        "--folder", type=Path, default=Path("runs/loss_curves"), help="for resuming"
    )
    parser.add_argument("--out", type=Path, help="JSON file to write")
    parser.add_argument("--picture", type=Path, help="picture to draw")
    arguments = parser.parse_args()
    settings = Settings(
        arguments.steps,
        arguments.batch_size,
        DataConfig(arguments.data, size=(160, 128), room_frames=3, cache=arguments.cache),
        OptimizerConfig(lr=6e-4, steps=arguments.steps, gradient_clip=1.0),
        arguments.folder,
    )
    samples = SampleStream(settings.data, seed=0)
    with Progress() as progress:
        found = {name: compare(name, settings, samples, progress) for name in arguments.models}
    for name, result in found.items():
        print(
            f"{name}: ours is {result['ours_from_textbook']:.1%} from the textbook's curve, other "
            f"weights are {result['chance_from_textbook']:.1%} from it: "
            f"{'within' if result['within_noise'] else 'NOT within'} noise"
        )
    if arguments.out:
        shared = {"batch_size": settings.batch_size, "data": asdict(settings.data)}
        device = "cuda" if torch.cuda.is_available() else "cpu"
        write_json(arguments.out, {**provenance(device), **shared, "models": found})
    if arguments.picture:
        draw(found, arguments.picture)


if __name__ == "__main__":
    main()
