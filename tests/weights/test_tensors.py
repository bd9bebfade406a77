import pickle
from pathlib import Path

import pytest
import torch

from mvsam.errors import InputError
from mvsam.weights import read_tensors
from tests.weights.conftest import trained


class _Runs:
    """Unpickling this writes a file."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.mark.parametrize("suffix", [".pth", ".ckpt"])
@pytest.mark.parametrize("write", [torch.save, lambda x, p: p.write_bytes(pickle.dumps(x, 2))])
def test_a_file_that_would_run_code_is_refused_and_does_not(tmp_path: Path, suffix: str, write):
    path, touched = tmp_path / f"evil{suffix}", tmp_path / "touched"
    write({"weight": torch.ones(1), "more": _Runs(touched)}, path)
    with pytest.raises(InputError, match="holds more than numbers"):
        read_tensors(path)
    assert not touched.exists()


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04rest", b"\x80\x02."])
def test_a_pth_that_is_none_is_refused(tmp_path: Path, content: bytes):
    path = tmp_path / "broken.pth"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"broken\.pth: not a readable weights file"):
        read_tensors(path)


def test_a_truncated_pth_is_refused(tmp_path: Path):
    path = tmp_path / "cut.pth"
    torch.save(trained().state_dict(), path)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(InputError, match="not a readable weights file"):
        read_tensors(path)
