"""The real driver on a run of seconds: resume after a kill, and two processes as one."""

import csv
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file

from mvsam import weights
from mvsam.data.labels import SCANNET20
from mvsam.errors import InputError
from mvsam.experiments import driver
from mvsam.experiments.checks import classes_of
from mvsam.experiments.config import ModelConfig
from mvsam.experiments.driver import (
    initial_model,
    precision_of,
    train,
    use_plain_attention,
)
from mvsam.experiments.runs import find_run
from mvsam.model import MultiViewSAM
from mvsam.weights import load_into, read_info, read_tensors, save
from tests.experiments.conftest import write_labelled_folder
from tests.experiments.small_run import (
    drive,
    gradients_of_one_step,
    run,
    small_experiment,
    with_singles,
)
from tests.small import SIDE, small_model

pytestmark = pytest.mark.filterwarnings("ignore")  # Lightning's and TensorBoard's own

ROOT = Path(__file__).parents[2]


def in_another_process(*arguments: object) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "tests.experiments.small_run", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)


def test_a_killed_and_resumed_run_ends_with_the_weights_of_one_never_killed(
    data: Path, finished: Path, tmp_path: Path
):
    killed = in_another_process(tmp_path, data, "--kill-at", 5)
    assert killed.returncode == -9, killed.stderr
    assert torch.load(tmp_path / "last.ckpt", weights_only=True)["global_step"] == 4
    half_way = read_tensors(tmp_path / "last.ckpt")
    assert not (tmp_path / "model.safetensors").exists()
    page = tmp_path / "experiment.json"
    page.write_text(
        page.read_text().replace('"began_with": "random"', '"began_with": "tiny of old"')
    )
    resumed = load_file(run(tmp_path, data))
    assert read_info(tmp_path / "model.json").training["began_with"] == "tiny of old"
    expected = load_file(finished / "model.safetensors")
    assert resumed.keys() == expected.keys()
    assert all(torch.equal(resumed[key], expected[key]) for key in expected)
    assert not torch.equal(resumed["decoder.class_tokens"], half_way["decoder.class_tokens"])


def test_what_is_frozen_stays_as_it_is_through_a_whole_run(data: Path, tmp_path: Path):
    """Lightning does not say `train()`, and validation says `eval()` in the middle of it."""
    experiment = small_experiment(data, 4, "32-true")
    frozen = replace(experiment, model=replace(experiment.model, tuned_blocks=0))
    counts = batches_counted(drive(frozen, tmp_path, 1))
    assert {n for key, n in counts.items() if "patch_embed" in key} == {0}
    assert all(n > 0 for key, n in counts.items() if "patch_embed" not in key)


def batches_counted(weights: Path) -> dict[str, int]:
    """How many batches each batch norm of a run took statistics of."""
    return {k: int(v) for k, v in load_file(weights).items() if k.endswith("batches_tracked")}


def test_single_photos_are_refused_where_the_model_cannot_learn_from_them(
    data: Path, tmp_path: Path
):
    experiment = with_singles(data, 1)
    experiment = replace(experiment, model=replace(experiment.model, name="cas_mvsnet"))
    with pytest.raises(InputError, match="cas_mvsnet cannot label single photos"):
        train(experiment, tmp_path)


@pytest.mark.parametrize(
    ("parts", "sentence"),
    [
        (("cascade.regularizer.0",), r"nearest names are cascade\.regularizers\.0"),
        (("prior", "decoder.upscaling.0.act"), "no part of tiny"),
        (("cascade.regularizers.0.entry.2",), "has nothing that learns"),
    ],
)
def test_parts_that_cannot_learn_are_refused(data: Path, tmp_path: Path, parts, sentence: str):
    experiment = small_experiment(data, 2, "32-true")
    experiment = replace(experiment, train=replace(experiment.train, parts=parts))
    with pytest.raises(InputError, match=sentence):
        train(experiment, tmp_path)


def test_a_run_goes_on_with_the_parts_it_began_with(data: Path, tmp_path: Path):
    experiment = small_experiment(data, 2, "32-true")
    first = replace(experiment, train=replace(experiment.train, parts=("prior",)))
    counts = batches_counted(drive(first, tmp_path, 1))
    assert {n > 0 for key, n in counts.items() if key.startswith("prior")} == {True}
    assert {n for key, n in counts.items() if not key.startswith("prior")} == {0}
    with pytest.raises(InputError, match=r"began with --train\.parts prior"):
        train(experiment, tmp_path)


def test_a_finished_run_leaves_weights_page_checkpoint_record_and_logs(finished: Path):
    names = {path.name for path in finished.iterdir()}
    assert {
        *("model.safetensors", "model.json", "last.ckpt", "experiment.json", "metrics.csv")
    } <= names
    assert any(name.startswith("events.out.tfevents") for name in names)
    info = read_info(finished / "model.json")
    assert info.model == "tiny" and info.training["steps"] == 6
    assert info.training["began_with"] == "random"
    assert "val/rel" in (finished / "metrics.csv").read_text().splitlines()[0]


def test_the_last_checkpoint_holds_the_weights_and_no_code(finished: Path):
    tensors = read_tensors(finished / "last.ckpt")
    expected = load_file(finished / "model.safetensors")
    assert all(torch.equal(tensors[key], expected[key]) for key in expected)


def test_a_checkpoint_that_would_run_code_is_not_resumed(data: Path, tmp_path: Path):
    torch.save({"state_dict": {}, "evil": Path("x")}, tmp_path / "last.ckpt")
    with pytest.raises(InputError, match="holds more than numbers"):
        run(tmp_path, data)


def test_training_changes_every_kind_of_weight(finished: Path):
    before, after = small_model("tiny").state_dict(), load_file(finished / "model.safetensors")
    assert before.keys() == after.keys()
    starts = {key.split(".")[0] for key in after if not torch.equal(before[key], after[key])}
    assert starts >= {"geometry_encoder", "semantic_encoder", "cascade", "prompt", "decoder"}


def last_scores(folder: Path) -> list[float]:
    """Rel and mIoU of the last validation."""
    with (folder / "metrics.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["val/rel"]]
    return [float(rows[-1][name]) for name in ("val/rel", "val/miou")]


def test_two_processes_give_the_gradients_and_the_scores_of_one_with_the_doubled_batch(
    data: Path, tmp_path: Path
):
    for index in range(3):  # which two processes cannot share evenly
        write_labelled_folder(tmp_path / "val" / f"room{index}", baseline=0.08 + 0.02 * index)
    gradients_of_one_step(tmp_path / "one", data, tmp_path / "val", devices=1)
    arguments = (tmp_path / "two", data, "--gradients", tmp_path / "val", "--devices", 2)
    result = in_another_process(*arguments)
    assert result.returncode == 0, result.stderr[-3000:]
    # Sums over as many pixels, in float32 and perhaps on another number of threads.
    assert last_scores(tmp_path / "two") == pytest.approx(last_scores(tmp_path / "one"), rel=1e-3)
    one = torch.load(tmp_path / "one" / "gradients0.pt")
    first, second = (torch.load(tmp_path / "two" / f"gradients{rank}.pt") for rank in (0, 1))
    assert one.keys() == first.keys() == second.keys()
    for name, expected in one.items():
        assert torch.equal(first[name], second[name]), name
        # Means of means in float32, against gradients of very different size.
        scale = expected.abs().max().clamp(min=1e-3)
        assert (first[name] - expected).abs().max() < 1e-3 * scale, name


def test_the_model_may_begin_with_other_weights(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("mvsam.assemblies.tiny.TINY_SIDE", SIDE)
    given = small_model("tiny", seed=5)
    save(given, tmp_path / "given.safetensors", "tiny")
    config = replace(find_run("tiny").model, init=(str(tmp_path / "given.safetensors"),))
    state = initial_model(config).state_dict()
    assert all(torch.equal(state[key], value) for key, value in given.state_dict().items())


def test_plain_attention_computes_what_the_fused_one_does():
    model, images = small_model("base").eval(), torch.rand(1, 3, SIDE, SIDE)
    assert model.semantic_encoder is not None
    with torch.no_grad():
        expected = model.semantic_encoder(images)
        use_plain_attention(model)
        torch.testing.assert_close(model.semantic_encoder(images), expected, atol=1e-5, rtol=1e-5)


def test_a_batch_that_the_processes_cannot_share_is_refused(data: Path, tmp_path: Path):
    with pytest.raises(InputError, match="batch of 2 cannot be shared by 3 processes"):
        train(small_experiment(data, 1, "auto"), tmp_path, devices=3)
    assert not list(tmp_path.iterdir())


def test_more_references_than_views_are_refused(data: Path, tmp_path: Path):
    experiment = small_experiment(data, 1, "auto")
    experiment = replace(experiment, data=replace(experiment.data, references=4))
    with pytest.raises(InputError, match="4 references of 3 views"):
        train(experiment, tmp_path)


@pytest.mark.parametrize(
    ("fewest", "words"), [(1, "2 references of 1 views"), (4, "fewest 4 of 3 views")]
)
def test_a_number_of_views_that_cannot_be_had_is_refused(
    data: Path, tmp_path: Path, fewest: int, words: str
):
    experiment = small_experiment(data, 1, "auto")
    experiment = replace(experiment, data=replace(experiment.data, fewest_views=fewest))
    with pytest.raises(InputError, match=words):
        train(experiment, tmp_path)


def test_a_named_precision_is_kept_and_auto_follows_the_hardware(monkeypatch):
    assert precision_of("32-true", "cpu") == "32-true"
    for has, expected in ((True, "bf16-mixed"), (False, "32-true")):
        monkeypatch.setattr(driver, "has_native_bfloat16", lambda device, has=has: has)
        assert precision_of("auto", "cuda") == expected


def test_attention_is_written_out_on_a_processor_alone(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr("mvsam.assemblies.tiny.TINY_SIDE", SIDE)
    for device, is_fused in (("cpu", False), ("cuda", True)):
        model = initial_model(ModelConfig("tiny_semantic", init=("tiny",)), device)
        assert isinstance(model, MultiViewSAM) and model.semantic_encoder is not None
        blocks = model.semantic_encoder.backbone.blocks
        assert all(block.attn.fused_attn is is_fused for block in blocks)  # pyright: ignore


def test_the_last_checkpoint_is_loaded_with_the_run_s_own_record(finished: Path, monkeypatch):
    monkeypatch.setattr("mvsam.assemblies.tiny.TINY_SIDE", SIDE)
    model = weights.load(str(finished / "last.ckpt"))
    assert model.info.training["run"] == "small"  # pyright: ignore
    assert model.input_size == (SIDE, SIDE)
    expected = load_file(finished / "model.safetensors")
    assert all(torch.equal(v, expected[k]) for k, v in model.state_dict().items())


def test_a_run_has_as_many_classes_as_its_data(data: Path, tmp_path: Path):
    experiment = small_experiment(data, 1, "auto")
    assert classes_of(experiment).names == SCANNET20.names
    own = shutil.copytree(data, tmp_path / "own")
    table = [{"name": "rock", "color": [1, 2, 3]}, {"name": "sand", "color": [4, 5, 6]}]
    (own / "classes.json").write_text(json.dumps(table))
    experiment = small_experiment(own, 1, "auto")
    assert classes_of(experiment).names == ("rock", "sand")
    twenty = replace(experiment, model=replace(experiment.model, num_classes=20))
    with pytest.raises(InputError, match=r"num-classes 20, but .*own has 2 classes"):
        classes_of(twenty)


def test_weights_remember_the_size_of_the_pictures_they_were_trained_on(finished: Path):
    """`mvsam predict` resizes photos to it: a decoder trained at half size is lost at full size."""
    assert read_info(finished / "model.json").input_size == (SIDE, SIDE)


def test_a_run_that_weighs_the_rooms_classes_trains_on_a_user_s_own(
    data: Path, tmp_path: Path, caplog
):
    own = shutil.copytree(data, tmp_path / "own")
    names = SCANNET20.names[:12]
    table = [{"name": name, "color": [i, i, i]} for i, name in enumerate(names)]
    (own / "classes.json").write_text(json.dumps(table))
    for path in (own / "labels").iterdir():
        Image.fromarray(np.minimum(np.asarray(Image.open(path)), 11)).save(path)
    experiment = replace(small_experiment(own, 1, "auto"), loss=find_run("tiny_joint").loss)
    target = drive(experiment, tmp_path / "run", devices=1)
    assert "the run weighs 20 classes and the data have 12" in caplog.text
    assert read_info(target.with_suffix(".json")).num_classes == 12
    saved = json.loads((tmp_path / "run" / "experiment.json").read_text())
    assert saved["loss"]["class_weights"] is None


def test_class_weights_stay_where_the_data_have_as_many_classes():
    experiment = find_run("tiny_joint")
    assert driver._with_classes(experiment, 20).loss == experiment.loss


def test_fine_tuning_takes_a_training_checkpoint(finished: Path):
    model = small_model("tiny", num_classes=3)
    assert load_into(model, str(finished / "last.ckpt")) == ["decoder.class_tokens"]
    assert weights.read_info(finished / "model.json").num_classes == 20
