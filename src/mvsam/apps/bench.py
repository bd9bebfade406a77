"""Speed and memory of models on this machine, box by box of Figure 3.

Each case runs in a process of its own, so that its peak memory is its own.
"""

import json
import os
import resource
import subprocess
import sys
import time
from collections import defaultdict
from dataclasses import asdict, dataclass

import torch
from torch import nn

from mvsam.build import build, model_spec
from mvsam.model import MultiViewSAM
from mvsam.mvs.sweep import load_kernel
from mvsam.provenance import provenance
from mvsam.types import Views
from mvsam.weights import layout_channels_last

BOXES = (
    "semantic_encoder",
    "geometry_encoder",
    "bridge",
    "cascade",
    "prompt",
    "decoder",
)
"""Attributes of a model that are timed apart."""


@dataclass(frozen=True)
class Case:
    """One row of the benchmark."""

    model: str
    precision: str
    """float32 or bfloat16."""
    num_views: int = 3
    width: int = 320
    height: int = 256
    repeats: int = 3


@dataclass(frozen=True)
class Measurement:
    """Seconds (medians, but for the boxes) and peak memory of one case."""

    case: Case
    seconds: float
    """One reference, encoders included."""
    seconds_all_references: float
    """Every view as reference in turn, features computed once."""
    stages: dict[str, float]
    """Mean seconds of each box in a call like that of `seconds`."""
    peak_mib: float
    """Largest resident size of the process."""
    libraries_mib: float
    """Resident size before the model was built."""


def measure(case: Case) -> Measurement:
    """Runs one case in this process; `run_case` gives it a fresh one."""
    libraries = _resident_mib()
    torch.manual_seed(0)
    load_kernel()  # a first run compiles it
    model = layout_channels_last(build(case.model)).eval()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    model, views = model.to(device), synthetic_views(case).to(device)
    clock = BoxClock(model)

    def one() -> None:
        model(views)

    use_bfloat16 = case.precision == "bfloat16"
    with torch.inference_mode(), torch.autocast(device, torch.bfloat16, enabled=use_bfloat16):
        one()  # warm up
        clock.seconds.clear()
        seconds = _median(one, case.repeats)
        stages = {box: total / case.repeats for box, total in clock.seconds.items()}
        all_references = _median(lambda: every_reference(model, views), case.repeats)
    return Measurement(case, seconds, all_references, stages, _resident_mib(), libraries)


def every_reference(model: MultiViewSAM, views: Views) -> None:
    """Each view as reference in turn, encoded once; view 0 alone where it has measured depth."""
    features = model.encode(views)
    for reference in range(1 if views.measured_depth is not None else views.num_views):
        model.decode(features, views, reference)


def run_case(case: Case) -> Measurement:
    """`measure` in a fresh process."""
    command = [sys.executable, "-m", "mvsam.apps.bench", json.dumps(asdict(case))]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    content = json.loads(done.stdout.splitlines()[-1])
    return Measurement(**{**content, "case": Case(**content["case"])})


def synthetic_views(case: Case) -> Views:
    """Random pictures from cameras 10 cm apart; speed does not depend on what they show."""
    count, width, height = case.num_views, case.width, case.height
    focal = 0.9 * width
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    world_from_cam = torch.eye(4).repeat(count, 1, 1)
    world_from_cam[:, 0, 3] = 0.1 * torch.arange(count)
    return Views(
        images=torch.rand(1, count, 3, height, width),
        intrinsics=intrinsics.expand(1, count, 3, 3),
        world_from_cam=world_from_cam[None],
        depth_range=torch.tensor([[0.1, 5.0]]),
        measured_depth=torch.full((1, height, width), 2.0)
        if _needs_measured_depth(case.model)
        else None,
    )


def _needs_measured_depth(model: str) -> bool:
    return "measured depth" in model_spec(model).inputs


class BoxClock:
    """Adds up the seconds inside each of `BOXES`, by forward hooks."""

    def __init__(self, model: nn.Module):
        self.seconds: defaultdict[str, float] = defaultdict(float)
        for box in BOXES:
            module = getattr(model, box, None)
            if module is not None:
                started: list[float] = []
                module.register_forward_pre_hook(lambda *_, s=started: s.append(_now()))
                module.register_forward_hook(lambda *_, s=started, b=box: self._stop(b, s))

    def _stop(self, box: str, started: list[float]) -> None:
        self.seconds[box] += _now() - started.pop()


def _now() -> float:
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return time.perf_counter()


def _median(work, repeats: int) -> float:
    seconds = []
    for _ in range(repeats):
        start = _now()
        work()
        seconds.append(_now() - start)
    return sorted(seconds)[len(seconds) // 2]


def _resident_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # KiB on Linux


def machine_record() -> dict:
    """What a reader needs to place the figures."""
    return {
        **provenance(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "kernel": "compiled" if load_kernel() else "plain PyTorch",
        "bfloat16_gflops": matmul_gflops(torch.bfloat16),
        "float32_gflops": matmul_gflops(torch.float32),
    }


def matmul_gflops(dtype: torch.dtype, size: int = 2048) -> float:
    """Rate of a square matrix product, the yardstick the other figures are read against."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    a = torch.randn(size, size, device=device).to(dtype)
    with torch.inference_mode():
        seconds = _median(lambda: torch.mm(a, a), 6)
    return 2 * size**3 / seconds / 1e9


if __name__ == "__main__":
    result = measure(Case(**json.loads(sys.argv[1])))
    print(json.dumps(asdict(result)))
