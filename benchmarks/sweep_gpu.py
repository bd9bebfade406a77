"""Milliseconds, memory and bandwidth of the plane sweep on a GPU: Triton beside plain PyTorch.

    python benchmarks/sweep_gpu.py --out results/sweep_gpu.json

The three stages of the paper's cascade, forward alone and forward with backward; medians, the L2
cache emptied before each call. `sweep` is the operation itself, `volume` adds the projections as
a model does (`variance_volume`), `textbook` is plain PyTorch. `gb_per_second` divides the fewest
bytes possible (each input read once, each output written once) by the time; hold it against
`copy_gb_per_second`. `output_error` and `gradient_error` are relative to the textbook in float64.
"""

import argparse
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import torch
from torch import Tensor

from mvsam.files import write_json
from mvsam.mvs.cost_volume import (
    HAS_TRITON,
    sweep_projections,
    textbook_variance_volume,
    variance_volume,
)
from mvsam.mvs.hypotheses import base_interval, plane_depths, window_hypotheses
from mvsam.provenance import provenance

Volume = Callable[[Tensor], Tensor]
"""Features to variances; the cameras are settled."""


@dataclass(frozen=True)
class Stage:
    """One sweep of the cascade."""

    channels: int
    planes: int
    interval_ratio: float
    reduction: int
    """Picture pixels to one of the features, along each axis."""


STAGES = (Stage(32, 48, 4, 4), Stage(16, 32, 1, 2), Stage(8, 8, 0.5, 1))


def problem(stage: Stage, batch: int, views: int, width: int, height: int) -> list[Tensor]:
    """Features, intrinsics, poses 10 cm apart; planes first, then windows about a slanted wall."""
    width, height = width // stage.reduction, height // stage.reduction
    features = torch.randn(batch, views, height, width, stage.channels).permute(0, 1, 4, 2, 3)
    focal = 0.9 * width
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    world_from_cam = torch.eye(4).repeat(views, 1, 1)
    world_from_cam[:, 0, 3] = 0.1 * torch.arange(views)
    depth_range = torch.tensor([[0.1, 5.0]]).expand(batch, 2)
    if stage is STAGES[0]:
        planes = plane_depths(depth_range, stage.planes)
        hypotheses = planes[:, :, None, None].expand(-1, -1, height, width)
    else:
        wall = torch.linspace(1, 4, width).expand(batch, height, width)
        half_width = base_interval(depth_range) * stage.interval_ratio * stage.planes / 2
        hypotheses = window_hypotheses(wall, half_width, stage.planes, depth_range[:, 0])
    return [
        features,
        intrinsics.expand(batch, views, 3, 3),
        world_from_cam.expand(batch, views, 4, 4),
        hypotheses,
    ]


def least_bytes(features: Tensor, hypotheses: Tensor) -> tuple[int, int]:
    """Forward, and backward: each input read once, each output written once."""
    volume = features.nbytes // features.shape[1] * hypotheses.shape[1]
    is_expanded = hypotheses.stride(-1) == 0
    depths = 4 * (hypotheses.shape[:2].numel() if is_expanded else hypotheses.numel())
    return features.nbytes + depths + volume, 2 * features.nbytes + depths + volume


def measure(volume: Volume, features: Tensor, incoming: Tensor) -> dict[str, float]:
    """Milliseconds, and MiB allocated beyond what was there before."""

    def forward() -> None:
        with torch.no_grad():
            volume(features)

    def both() -> None:
        torch.autograd.grad(volume(features), features, incoming)

    return {
        "forward_ms": median_ms(forward),
        "forward_backward_ms": median_ms(both),
        "forward_mib": working_mib(forward),
        "forward_backward_mib": working_mib(both),
    }


def median_ms(call: Callable[[], object]) -> float:
    from triton.testing import do_bench

    return do_bench(call, return_mode="median")  # pyright: ignore[reportReturnType]


def working_mib(call: Callable[[], object]) -> float:
    before = torch.cuda.memory_allocated()
    torch.cuda.reset_peak_memory_stats()
    call()
    return (torch.cuda.max_memory_allocated() - before) / 2**20


def copy_gb_per_second(size: int = 2**30) -> float:
    """Bytes read and written by a copy within the GPU."""
    source = torch.randint(0, 256, (size,), dtype=torch.uint8, device="cuda")
    target = torch.empty_like(source)
    return 2 * size / median_ms(lambda: target.copy_(source)) / 1e6


def errors(volume: Volume, textbook: Volume, features: Tensor, incoming: Tensor) -> dict:
    """Norm of the difference from the textbook in float64, over the latter's norm."""

    def run(compute: Volume, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
        leaf = features.detach().to(dtype).requires_grad_()
        result = compute(leaf)
        (gradient,) = torch.autograd.grad(result, leaf, incoming.to(dtype))
        return result.detach().double(), gradient.double()

    pairs = zip(run(volume, features.dtype), run(textbook, torch.float64), strict=True)
    found = [((actual - exact).norm() / exact.norm()).item() for actual, exact in pairs]
    return dict(zip(("output_error", "gradient_error"), found, strict=True))


def measure_stage(stage: Stage, dtype: torch.dtype, sizes: dict[str, int]) -> dict:
    from mvsam.mvs.sweep_triton import sweep_variance

    features, *cameras = (x.cuda() for x in problem(stage, **sizes))
    features = features.to(dtype).requires_grad_()
    intrinsics, world_from_cam, hypotheses = cameras
    projections = sweep_projections(intrinsics, world_from_cam)
    volumes: dict[str, Volume] = {
        "sweep": lambda x: sweep_variance(x, projections, hypotheses),
        "volume": lambda x: variance_volume(x, *cameras),
        "textbook": lambda x: textbook_variance_volume(x, *cameras),
    }
    incoming = torch.randn_like(volumes["sweep"](features))
    record = {name: measure(volume, features, incoming) for name, volume in volumes.items()}
    forward, backward = least_bytes(features, hypotheses)
    times = record["sweep"]
    return {
        **asdict(stage),
        "dtype": str(dtype).removeprefix("torch."),
        **record,
        "gb_per_second": {
            "forward": forward / times["forward_ms"] / 1e6,
            "forward_backward": (forward + backward) / times["forward_backward_ms"] / 1e6,
        },
        **errors(volumes["sweep"], volumes["textbook"], features, incoming),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--batch", type=int, default=1)
    parser.add_argument("--views", type=int, default=3)
    parser.add_argument("--width", type=int, default=320, help="of the pictures")
    parser.add_argument("--height", type=int, default=256, help="of the pictures")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    if not (torch.cuda.is_available() and HAS_TRITON):
        parser.error(
            "this measures a GPU: run it where torch.cuda.is_available() is true and Triton, "
            "which comes with PyTorch on Linux, is installed."
        )
    sizes = {name: getattr(arguments, name) for name in ("batch", "views", "width", "height")}
    record = {**provenance("cuda"), "triton": version("triton"), **sizes}
    record["copy_gb_per_second"] = copy_gb_per_second()
    record["stages"] = []
    print(f"copy {record['copy_gb_per_second']:.0f} GB/s")
    for dtype in (torch.float32, torch.bfloat16):
        for stage in STAGES:
            row = measure_stage(stage, dtype, sizes)
            record["stages"].append(row)
            print(row)
            if arguments.out:  # after every row: what is measured is kept if time runs out
                write_json(arguments.out, record)


if __name__ == "__main__":
    main()
