from dataclasses import replace
from pathlib import Path

import pytest

from mvsam.errors import InputError
from mvsam.experiments.checks import check_settings
from mvsam.experiments.config import DataConfig, Experiment, ModelConfig
from mvsam.experiments.driver import initial_model
from mvsam.model import MultiViewSAM
from tests.small import small_backbone


def test_a_run_on_a_frozen_encoder_may_keep_its_features(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("mvsam.assemblies.paper.sam_vit_b", small_backbone)
    model = initial_model(ModelConfig("base", tuned_blocks=1, feature_cache=str(tmp_path)))
    assert isinstance(model, MultiViewSAM) and model.semantic_encoder is not None
    cache = model.semantic_encoder.feature_cache
    assert cache is not None and cache.folder == tmp_path
    with pytest.raises(InputError, match="no frozen features"):
        initial_model(ModelConfig("tiny", feature_cache=str(tmp_path)))
    with pytest.raises(InputError, match="no SAM encoder"):
        initial_model(ModelConfig("cas_mvsnet", feature_cache=str(tmp_path)))


@pytest.mark.parametrize("change", [{"mirror": True}, {"color_jitter": 0.2}, {"singles": "nyu"}])
def test_pictures_that_never_come_again_are_not_kept(tmp_path: Path, change: dict):
    model = ModelConfig("base", feature_cache=str(tmp_path))
    experiment = Experiment("mine", "", model=model, data=replace(DataConfig(), **change))
    with pytest.raises(InputError, match="leave one of them out"):
        check_settings(experiment, 1)
    check_settings(replace(experiment, data=DataConfig()), 1)
