import subprocess
import sys

from mvsam.memory import peak_memory


def test_the_peak_grows_with_what_is_held_and_stays():
    before = peak_memory("cpu")
    held = bytearray(b"\1") * (before + 2**24)
    grown = peak_memory("cpu")
    assert grown > len(held)
    del held
    assert peak_memory("cpu") > 0.99 * grown  # Linux adds up its counters loosely


def test_a_child_does_not_begin_with_the_peak_of_its_parent():
    held = bytearray(b"\1") * 2**28
    statement = "from mvsam.memory import peak_memory; print(peak_memory('cpu'))"
    child = subprocess.run(
        [sys.executable, "-c", statement], check=True, capture_output=True, text=True
    )
    assert int(child.stdout) < len(held)
