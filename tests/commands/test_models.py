import sys

from mvsam.build import MODELS
from mvsam.commands.models import Models, describe_models


def test_a_model_whose_library_is_missing_is_listed_without_its_parameters(monkeypatch, capsys):
    monkeypatch.setattr("mvsam.build.MODELS", {"mvs_unet": MODELS["mvs_unet"]})
    monkeypatch.setitem(sys.modules, "segmentation_models_pytorch", None)
    (model,) = describe_models()
    assert model["name"] == "mvs_unet" and model["parameters"] is None
    Models().run()
    assert "mvs_unet" in capsys.readouterr().out
