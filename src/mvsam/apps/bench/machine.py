"""What a reader needs to place the figures."""

import os

import torch

from mvsam.apps.bench.clock import StageClock
from mvsam.kernels import load_kernel
from mvsam.mvs.sweep import SOURCE
from mvsam.precision import has_native_bfloat16
from mvsam.provenance import provenance


def machine_record(device: str) -> dict:
    """Provenance, cores, and how fast matrix products are.

    `bfloat16_gflops` is None where the device only emulates them, which takes minutes to measure.
    """
    is_native = has_native_bfloat16(device)
    return {
        **provenance(device),
        "ran_on": device,
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "kernel": "compiled" if load_kernel(SOURCE) else "plain PyTorch",
        "bfloat16_gflops": matmul_gflops(torch.bfloat16, device) if is_native else None,
        "float32_gflops": matmul_gflops(torch.float32, device),
    }


def matmul_gflops(dtype: torch.dtype, device: str = "cpu", size: int = 2048) -> float:
    """Rate of a square matrix product, the yardstick the other figures are read against."""
    a = torch.randn(size, size, device=device).to(dtype)
    with torch.inference_mode():
        torch.mm(a, a)  # warm up
        seconds = StageClock(device).median_seconds(lambda: torch.mm(a, a), 5)
    return 2 * size**3 / seconds / 1e9
