"""How much memory this process takes, and has taken at most; and that it keeps what it has."""

import ctypes
import platform
from contextlib import suppress
from pathlib import Path


def memory_in_use(device: str) -> int:
    """Bytes of `device` ("cpu" or "cuda") that this process holds now, counted as `peak_memory`."""
    if device == "cuda":
        import torch

        return torch.cuda.memory_allocated()
    for line in _status_lines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) * 1024
    return peak_memory(device)  # other systems do not say


def peak_memory(device: str) -> int:
    """Bytes of `device` ("cpu" or "cuda") that this process held at most so far.

    On a GPU what tensors took; on a processor the largest resident size, libraries included.
    """
    if device == "cuda":
        import torch

        return torch.cuda.max_memory_allocated()
    # Linux's getrusage would begin at the parent's peak: that figure outlives fork and exec.
    for line in _status_lines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    import resource  # not on every system

    unit = 1 if platform.system() == "Darwin" else 1024  # macOS counts in bytes
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def forget_peak(device: str) -> None:
    """From here on `peak_memory` counts anew, where the system allows it (Linux does, GPUs do)."""
    if device == "cuda":
        import torch

        torch.cuda.reset_peak_memory_stats()
        return
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")  # the resident peak becomes the present size


def keep_freed_memory() -> None:
    """From now on this process uses freed memory again instead of giving it back to the system.

    The C library of Linux gives every large block back at once, so that each volume of a training
    step costs the system a clearing of new pages (docs/log.md). Elsewhere nothing changes.
    """
    if platform.libc_ver()[0] == "glibc":
        library = ctypes.CDLL(None)
        no_blocks_apart, keep_up_to = (-4, 0), (-1, 2**31 - 1)  # M_MMAP_MAX, M_TRIM_THRESHOLD
        library.mallopt(*no_blocks_apart)
        library.mallopt(*keep_up_to)


def _status_lines() -> list[str]:
    try:
        return Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return []
