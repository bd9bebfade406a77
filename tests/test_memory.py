import platform
import subprocess
import sys

import pytest

from mvsam.memory import forget_peak, memory_in_use, peak_memory


def test_the_peak_grows_with_what_is_held_and_stays():
    before = peak_memory("cpu")
    held = bytearray(b"\1") * (before + 2**24)
    grown = peak_memory("cpu")
    assert grown > len(held)
    del held
    assert peak_memory("cpu") > 0.99 * grown  # Linux adds up its counters loosely


@pytest.mark.skipif(platform.system() != "Linux", reason="other systems count from the start")
def test_a_forgotten_peak_is_counted_anew():
    held = bytearray(b"\1") * (200 * 2**20)
    high = peak_memory("cpu")
    del held
    forget_peak("cpu")
    assert peak_memory("cpu") < high - 150 * 2**20
    assert peak_memory("cpu") == pytest.approx(memory_in_use("cpu"), abs=20 * 2**20)


def test_a_child_does_not_begin_with_the_peak_of_its_parent():
    held = bytearray(b"\1") * 2**28
    statement = "from mvsam.memory import peak_memory; print(peak_memory('cpu'))"
    child = subprocess.run(
        [sys.executable, "-c", statement], check=True, capture_output=True, text=True
    )
    assert int(child.stdout) < len(held)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_kept_memory_is_used_again_without_new_pages():
    script = """
from resource import RUSAGE_SELF, getrusage
from mvsam.memory import keep_freed_memory
keep_freed_memory()
def new_pages():
    before = getrusage(RUSAGE_SELF).ru_minflt
    held = bytearray(b"1") * 2**26
    return getrusage(RUSAGE_SELF).ru_minflt - before
print(new_pages() > 1000, new_pages() < 100)
"""
    child = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    assert child.stdout.split() == [b"True", b"True"]
