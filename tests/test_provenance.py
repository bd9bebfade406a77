import re
import subprocess

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
    assert record["command"] and record["device"]
    assert {"python", "torch", "mvsam"} <= set(record["versions"])
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", record["date"])
