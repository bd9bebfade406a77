"""How much memory this process takes, and has taken at most."""

import platform
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


def _status_lines() -> list[str]:
    try:
        return Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return []
