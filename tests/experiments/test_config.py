import json

from mvsam.data.labels import SCANNET20
from mvsam.experiments.config import Experiment
from mvsam.experiments.runs import find_run
from mvsam.provenance import commit
from mvsam.training.losses import JointLoss


def test_a_saved_record_holds_every_setting_the_commit_and_the_versions(tmp_path):
    run = find_run("tiny")
    run.save(tmp_path / "new" / "experiment.json", SCANNET20, "random", "cpu")
    record = json.loads((tmp_path / "new" / "experiment.json").read_text())
    assert record["model"]["name"] == "tiny" and record["train"]["seed"] == 0
    assert record["optimizer"]["lr"] == run.optimizer.lr and record["data"]["size"] == [320, 256]
    assert (record["loss"]["part"], record["loss"]["beta"]) == ("JointLoss", 0.02)
    assert record["optimizer"]["schedule"] == {
        "part": "OneCycle",
        "rising": 0.1,
        "first": 0.04,
        "last": 4e-06,
    }
    assert record["classes"] == list(SCANNET20.names)
    assert record["commit"] == commit()
    assert {"torch", "timm", "lightning", "mvsam"} <= set(record["versions"])


def test_settings_are_those_of_the_paper_unless_a_run_says_otherwise():
    run = Experiment("any", "")
    assert (run.optimizer.lr, run.optimizer.sam_lr, run.optimizer.weight_decay) == (
        1e-3,
        1e-4,
        1e-2,
    )
    assert run.loss == JointLoss(alpha=1.0, beta=0.02)
    assert (run.train.batch_size, run.data.num_views) == (8, 3)
    assert (run.data.size, run.data.depth_range) == ((320, 256), (0.1, 5.0))
