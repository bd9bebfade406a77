"""C++ files of this package, compiled on first use for this processor.

Without a compiler `load_kernel` returns None and everything runs in plain PyTorch, slower.
"""

import ctypes
import hashlib
import logging
import os
import platform
import subprocess
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from shutil import which

import torch

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
def load_kernel(source: Path) -> ctypes.CDLL | None:
    """The compiled file, or None (said once) where there is no C++ compiler.

    It is kept in `$MVSAM_CACHE` (default ~/.cache/mvsam), by source, flags and processor.
    """
    if is_switched_off():
        return None
    compiler = which("c++") or which("g++") or which("clang++")
    key = hashlib.sha256(source.read_bytes() + " ".join(_FLAGS).encode() + _processor()).hexdigest()
    try:
        library = _cache_folder() / f"{source.stem}-{key[:16]}.so"
        if not library.exists():
            if compiler is None:
                _log.info("no C++ compiler found: %s runs in plain PyTorch, slower", source.stem)
                return None
            _compile(compiler, source, library)
        return ctypes.CDLL(str(library))
    except (OSError, RuntimeError, subprocess.CalledProcessError) as error:
        _log.warning("%s could not be built (%s): PyTorch instead", source.name, error)
        return None


def _cache_folder() -> Path:
    """RuntimeError without a home: containers run under user ids that have none."""
    named = os.environ.get("MVSAM_CACHE")
    return Path(named) if named else Path.home() / ".cache" / "mvsam"


def _processor() -> bytes:
    """What -march=native depends on, so that a shared home folder serves different machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    telling = ("flags", "model name", "Features", "CPU part")  # the latter two on ARM
    told = [line for line in lines[:40] if line.startswith(telling)]
    return "".join([platform.machine(), *told]).encode()


def _compile(compiler: str, source: Path, library: Path) -> None:
    library.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        built = Path(folder) / library.name
        command = [compiler, *_FLAGS, str(source), "-o", str(built)]
        subprocess.run(command, check=True, capture_output=True)
        built.replace(library)  # atomic: another process never sees half a library


def num_shares(rows: int) -> int:
    """How many threads share so many rows."""
    return max(1, min(torch.get_num_threads(), rows))


def share_rows(work: Callable[[int, int, int], None], rows: int) -> None:
    """`work(begin, end, thread)` over all rows; ctypes lets go of Python's lock."""
    count = num_shares(rows)
    edges = [rows * i // count for i in range(count + 1)]
    if count == 1:
        work(0, rows, 0)
        return
    with ThreadPoolExecutor(count) as pool:
        list(pool.map(work, edges[:-1], edges[1:], range(count)))
