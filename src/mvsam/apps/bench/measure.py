"""Seconds and memory of one case, in a process of its own."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import chain
from multiprocessing import get_context

import torch

from mvsam.apps.bench.cases import Case, synthetic_targets, synthetic_views
from mvsam.apps.bench.clock import StageClock
from mvsam.apps.bench.forms import FORMS, Form
from mvsam.memory import peak_memory
from mvsam.mvs.sweep import load_kernel
from mvsam.precision import autocast
from mvsam.training.losses import JointLoss
from mvsam.training.optim import OptimizerConfig, make_optimizer
from mvsam.types import Model, Prediction

MIB = 2**20
REGULARIZERS = tuple(f"cascade.regularizers.{stage}" for stage in range(3))
BOXES = (
    *("semantic_encoder", "geometry_encoder", "bridge", "cascade"),
    *REGULARIZERS,
    *("prompt", "decoder"),
)
"""Parts of a model that are timed apart while predicting; the cascade's time includes that of its
regularizers. While training, `forward`, `backward` and `optimizer` are timed apart."""


@dataclass(frozen=True)
class Measurement:
    """Seconds (medians, but for the stages) and memory of one case."""

    case: Case
    seconds: float
    """One reference, encoders included; in training a step of one reference."""
    seconds_all_references: float
    """Every view as reference in turn; in training one step of them all."""
    stages: dict[str, float]
    """Mean seconds inside each stage of a call like that of `seconds`."""
    working_mib: float
    """Peak memory of one reference beyond libraries and weights; in training, gradients and the
    optimiser's state are part of it."""
    working_mib_all_references: float
    weights_mib: float
    """Parameters and buffers."""
    libraries_mib: float
    """Resident size of the process before the model was built."""


def run_case(case: Case) -> Measurement:
    """`measure` in a fresh process, so that peak memory is the case's own.

    MemoryError where the system ended that process.
    """
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        try:
            return pool.submit(measure, case).result()
        except BrokenProcessPool as error:
            raise MemoryError(
                f"the process that measured {case} was killed, most likely for want of memory"
            ) from error


def measure(case: Case) -> Measurement:
    """Runs one case in this process; `run_case` gives it a fresh one."""
    load_kernel()  # a first run compiles it
    libraries = peak_memory("cpu")
    torch.manual_seed(0)
    form = FORMS[case.form]
    model = form.prepare(case.model, case.work).to(case.device)
    if case.num_planes is not None:
        model.cascade.num_planes = case.num_planes  # pyright: ignore
    weights = sum(x.nbytes for x in chain(model.parameters(), model.buffers()))
    before = peak_memory(case.device)
    clock = StageClock(case.device)
    work = training if case.work == "train" else predicting
    one, every = work(case, model, form, clock)
    one()  # warm up
    clock.seconds.clear()
    seconds = clock.median_seconds(one, case.repeats)
    stages = {stage: total / case.repeats for stage, total in clock.seconds.items()}
    working = peak_memory(case.device) - before
    return Measurement(
        case,
        seconds=seconds,
        seconds_all_references=clock.median_seconds(every, case.repeats),
        stages=stages,
        working_mib=working / MIB,
        working_mib_all_references=(peak_memory(case.device) - before) / MIB,
        weights_mib=weights / MIB,
        libraries_mib=libraries / MIB,
    )


Calls = tuple[Callable[[], None], Callable[[], None]]
"""The work with one reference, and with every view as reference in turn."""


def predicting(case: Case, model: Model, form: Form, clock: StageClock) -> Calls:
    """Forward passes in inference mode; the clock watches `BOXES`."""
    views = synthetic_views(case).to(case.device)
    clock.watch(model, BOXES)

    def one() -> None:
        with torch.inference_mode(), autocast(case.device, case.precision):
            model(views)

    def every() -> None:
        with torch.inference_mode(), autocast(case.device, case.precision):
            form.every_reference(model, views)

    return one, every


def training(case: Case, model: Model, form: Form, clock: StageClock) -> Calls:
    """Steps of the paper's loss and optimiser on one sample."""
    views = synthetic_views(case).to(case.device)
    targets = synthetic_targets(case).to(case.device)
    loss = JointLoss()
    optimizer, _ = make_optimizer(model, OptimizerConfig())

    def step(predict: Callable[[], list[Prediction]]) -> None:
        with clock.stage("forward"), autocast(case.device, case.precision):
            losses = [loss(p, targets, views.depth_range)["loss"] for p in predict()]
            total = torch.stack(losses).mean()
        with clock.stage("backward"):
            total.backward()
        with clock.stage("optimizer"):
            optimizer.step()
            optimizer.zero_grad()

    def one() -> None:
        step(lambda: [model(views)])

    def every() -> None:
        step(lambda: form.every_reference(model, views))

    return one, every
