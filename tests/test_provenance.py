import re
import subprocess

import torch

from mvsam import provenance
from mvsam.provenance import commit


def test_outside_a_checkout_the_commit_is_unknown(monkeypatch):
    def fail(*_, **__):
        raise subprocess.CalledProcessError(128, "git")

    monkeypatch.setattr(provenance.subprocess, "run", fail)
    assert commit() == "unknown"


def test_results_say_by_which_command_commit_and_versions_they_came():
    record = provenance.provenance()
    assert re.fullmatch(r"[0-9a-f]{10}\+?|unknown", record["commit"])
    assert record["command"]
    assert {"python", "torch", "mvsam"} <= set(record["versions"])
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", record["date"])


def test_the_device_is_the_one_that_computed(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "get_device_name", lambda device: f"a GPU, {device}")
    assert provenance.device_name("cuda:1") == "a GPU, cuda:1"
    assert "a GPU" not in provenance.provenance()["device"]
