import sys

from mvsam.build import MODELS
from mvsam.commands.models import Models, describe_models
from mvsam.weights import ASSETS, embedded


def test_a_model_whose_library_is_missing_is_listed_without_its_parameters(monkeypatch, capsys):
    chosen = {name: MODELS[name] for name in ("mvs_unet", "tiny")}
    monkeypatch.setattr("mvsam.build.MODELS", chosen)
    monkeypatch.setitem(sys.modules, "segmentation_models_pytorch", None)
    model = describe_models()[0]
    assert model["name"] == "mvs_unet" and model["parameters"] is None
    Models().run()
    assert "mvs_unet" in capsys.readouterr().out


def test_embedded_weights_stand_beside_their_model_and_have_a_card(monkeypatch):
    monkeypatch.setattr("mvsam.build.MODELS", {"tiny": MODELS["tiny"]})
    (model,) = describe_models()
    assert model["weights"] == ["tiny", "tiny-nyu"] == embedded()
    assert all(
        (ASSETS / f"{name}.md").read_text().startswith("# Model card") for name in embedded()
    )
