"""The plane sweep as one operation on the CPU: `sweep.cpp`, compiled on first use.

Without a compiler `load_kernel` returns None and `cost_volume` takes its plain PyTorch form.
"""

import ctypes
import hashlib
import logging
import os
import subprocess
import tempfile
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from shutil import which

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

KERNEL_CHANNELS = (8, 16, 32)
MAXIMUM_VIEWS = 16
_FLAGS = (
    *("-O3", "-march=native", "-shared", "-fPIC", "-std=c++17"),
    # Not -ffast-math: it forgets NaN, and its start-up code changes the arithmetic of the process.
    *("-fno-math-errno", "-fno-trapping-math"),
)

_log = logging.getLogger(__name__)


def is_switched_off() -> bool:
    """Whether `MVSAM_KERNEL=0` asks for plain PyTorch, on a CPU and on a GPU."""
    return os.environ.get("MVSAM_KERNEL", "1") == "0"


@cache
def load_kernel() -> ctypes.CDLL | None:
    """The compiled kernel, or None (said once) where there is no C++ compiler.

    It is kept in `$MVSAM_CACHE` (default ~/.cache/mvsam), by source, flags and processor.
    """
    if is_switched_off():
        return None
    source = Path(__file__).with_name("sweep.cpp")
    compiler = which("c++") or which("g++") or which("clang++")
    key = hashlib.sha256(source.read_bytes() + " ".join(_FLAGS).encode() + _processor()).hexdigest()
    folder = Path(os.environ.get("MVSAM_CACHE", Path.home() / ".cache" / "mvsam"))
    library = folder / f"sweep-{key[:16]}.so"
    try:
        if not library.exists():
            if compiler is None:
                _log.info("no C++ compiler found: the plane sweep runs in plain PyTorch, slower")
                return None
            _compile(compiler, source, library)
        return ctypes.CDLL(str(library))
    except (OSError, subprocess.CalledProcessError) as error:
        _log.warning("the plane sweep kernel could not be built (%s): PyTorch instead", error)
        return None


def _processor() -> bytes:
    """What -march=native depends on, so that a shared home folder serves different machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return b""
    return "".join(line for line in lines[:40] if line.startswith(("flags", "model name"))).encode()


def _compile(compiler: str, source: Path, library: Path) -> None:
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        built = Path(folder) / library.name
        command = [compiler, *_FLAGS, str(source), "-o", str(built)]
        subprocess.run(command, check=True, capture_output=True)
        built.replace(library)  # atomic: another process never sees half a library


def fits_kernel(features: Tensor, hypotheses: Tensor) -> bool:
    """Whether the kernel can take this problem; `cost_volume` asks before it calls."""
    return (
        features.device.type == "cpu"
        and features.dtype in (torch.float32, torch.bfloat16)
        and hypotheses.dtype == torch.float32
        and features.shape[2] in KERNEL_CHANNELS
        and features.shape[1] <= MAXIMUM_VIEWS
        and load_kernel() is not None
    )


def sweep_variance(
    features: Float[Tensor, "batch view channel height width"],
    projections: Float[Tensor, "batch view 12"],
    hypotheses: Float[Tensor, "batch plane height width"],
) -> Float[Tensor, "batch channel plane height width"]:
    """Variance volume in channels-last layout, in the features' type; gradient to the features."""
    return _Sweep.apply(features, projections, hypotheses)


class _Sweep(torch.autograd.Function):
    @staticmethod
    def forward(ctx, features, projections, hypotheses):
        channels_last = features.detach().permute(0, 1, 3, 4, 2).float().contiguous()
        projections = projections.float().contiguous()
        batch, _, height, width, channels = channels_last.shape
        shape = (batch, hypotheses.shape[1], height, width, channels)
        volume = torch.empty(shape, dtype=features.dtype)
        for item in range(batch):
            call = _Call(channels_last[item], projections[item], hypotheses[item], volume[item])
            call.run_rows(lambda call, begin, end, _: call.forward(begin, end))
        ctx.save_for_backward(channels_last, projections, hypotheses)
        ctx.dtype = features.dtype
        return volume.permute(0, 4, 1, 2, 3)

    @staticmethod
    @once_differentiable
    def backward(ctx, volume_gradient):  # pyright: ignore[reportIncompatibleMethodOverride]
        channels_last, projections, hypotheses = ctx.saved_tensors
        incoming = volume_gradient.permute(0, 2, 3, 4, 1).contiguous()
        gradient = torch.empty_like(channels_last)
        for item in range(len(channels_last)):
            call = _Call(channels_last[item], projections[item], hypotheses[item], incoming[item])
            # Rows of the reference scatter anywhere into a source: a copy for each thread.
            copies = channels_last.new_zeros((call.num_threads, *channels_last[item].shape))
            call.run_rows(
                lambda call, begin, end, thread, copies=copies: call.backward(
                    begin, end, copies[thread]
                )
            )
            gradient[item] = copies.sum(0) if len(copies) > 1 else copies[0]
        return gradient.permute(0, 1, 4, 2, 3).to(ctx.dtype), None, None


class _Call:
    """One batch item's arguments in the kernel's terms."""

    def __init__(self, features: Tensor, projection: Tensor, hypotheses: Tensor, volume: Tensor):
        self.kernel = load_kernel()
        self.height = features.shape[1]
        self.volume = volume
        self.num_threads = max(1, min(torch.get_num_threads(), self.height))
        views, height, width, channels = features.shape
        strides = (ctypes.c_int64 * 3)(*hypotheses.stride())
        shape = (ctypes.c_int64 * 5)(views, hypotheses.shape[0], height, width, channels)
        pointers = [ctypes.c_void_p(x.data_ptr()) for x in (features, projection, hypotheses)]
        self.arguments = (*pointers, strides, shape)

    def run_rows(self, work) -> None:
        """`work(self, begin, end, thread)` over all rows; ctypes lets go of Python's lock."""
        count = self.num_threads
        edges = [self.height * i // count for i in range(count + 1)]
        if count == 1:
            work(self, 0, self.height, 0)
            return
        with ThreadPoolExecutor(count) as pool:
            list(pool.map(work, [self] * count, edges[:-1], edges[1:], range(count)))

    def forward(self, begin: int, end: int) -> None:
        assert self.kernel is not None
        is_bfloat16 = int(self.volume.dtype == torch.bfloat16)
        target = ctypes.c_void_p(self.volume.data_ptr())
        assert self.kernel.sweep_forward(*self.arguments, begin, end, is_bfloat16, target) == 0

    def backward(self, begin: int, end: int, gradient: Tensor) -> None:
        assert self.kernel is not None
        is_bfloat16 = int(self.volume.dtype == torch.bfloat16)
        incoming = ctypes.c_void_p(self.volume.data_ptr())
        target = ctypes.c_void_p(gradient.data_ptr())
        status = self.kernel.sweep_backward(
            *self.arguments, begin, end, is_bfloat16, incoming, target
        )
        assert status == 0
