"""Seconds and memory of one case, in a process of its own."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import chain
from multiprocessing import get_context

import torch

from mvsam import convolution_gradient
from mvsam.apps.bench.cases import Case, synthetic_targets, synthetic_views
from mvsam.apps.bench.clock import StageClock
from mvsam.apps.bench.forms import FORMS, Form
from mvsam.kernels import load_kernel
from mvsam.memory import forget_peak, memory_in_use, peak_memory
from mvsam.mvs import sweep
from mvsam.precision import autocast
from mvsam.training.losses import JointLoss
from mvsam.training.optim import OptimizerConfig, make_optimizer
from mvsam.types import Model

MIB = 2**20
REGULARIZERS = tuple(f"cascade.regularizers.{stage}" for stage in range(3))
BOXES = (
    *("semantic_encoder", "geometry_encoder", "bridge", "prior", "cascade"),
    *REGULARIZERS,
    *("context", "prompt", "decoder"),
)
"""Parts of a model that are timed apart while predicting; the cascade's time includes that of its
regularizers and of the context. While training, `forward`, `backward` and `optimizer` stand for
them."""


@dataclass(frozen=True)
class Measurement:
    """Seconds and memory of one case."""

    case: Case
    seconds: float
    """Of one call, encoders included, or of one training step: the median."""
    stages: dict[str, float]
    """Of it inside each stage: means."""
    working_mib: float
    """Peak memory beyond libraries and weights; in training, gradients and the optimiser's state
    are part of it."""
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
    for source in (convolution_gradient.SOURCE, sweep.SOURCE):
        load_kernel(source)  # a first run compiles it
    libraries = peak_memory("cpu")
    torch.manual_seed(0)
    form = FORMS[case.form]
    model = form.prepare(case).to(case.device)
    weights = sum(x.nbytes for x in chain(model.parameters(), model.buffers()))
    forget_peak(case.device)  # what building the model took for a moment is not its own
    before = memory_in_use(case.device)
    clock = StageClock(case.device)
    work = training if case.work == "train" else predicting
    call = work(case, model, form, clock)
    call()  # warm up
    clock.clear()
    seconds = clock.median_seconds(call, case.repeats)
    return Measurement(
        case,
        seconds,
        stages={stage: total / case.repeats for stage, total in clock.seconds().items()},
        working_mib=(peak_memory(case.device) - before) / MIB,
        weights_mib=weights / MIB,
        libraries_mib=libraries / MIB,
    )


def predicting(case: Case, model: Model, form: Form, clock: StageClock) -> Callable[[], None]:
    """A call of the model in inference mode; the clock watches `BOXES`."""
    views = synthetic_views(case).to(case.device)
    clock.watch(model, BOXES)

    def call() -> None:
        with torch.inference_mode(), autocast(case.device, case.precision):
            form.predict(model, views, case.num_references)

    return call


def training(case: Case, model: Model, form: Form, clock: StageClock) -> Callable[[], None]:
    """A step of the paper's loss and optimiser on one sample."""
    views = synthetic_views(case).to(case.device)
    targets = synthetic_targets(case).to(case.device)
    loss = JointLoss()
    optimizer, _ = make_optimizer(model, OptimizerConfig())

    def step() -> None:
        with clock.stage("forward"), autocast(case.device, case.precision):
            predictions = form.predict(model, views, case.num_references)
            losses = [loss(p, targets, views.depth_range)["loss"] for p in predictions]
            total = torch.stack(losses).mean()
        with clock.stage("backward"):
            total.backward()
        with clock.stage("optimizer"):
            optimizer.step()
            optimizer.zero_grad()

    return step
