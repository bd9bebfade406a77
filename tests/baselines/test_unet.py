from pathlib import Path

import pytest
import torch
from segmentation_models_pytorch import Unet

from mvsam.baselines.unet import UNet
from mvsam.build import build
from mvsam.encoders.sam import IMAGE_MEAN, IMAGE_STD
from mvsam.errors import InputError
from mvsam.experiments.config import ModelConfig
from mvsam.experiments.driver import initial_model
from mvsam.weights import load_into, save
from tests.small import random_views


def test_logits_are_the_library_s_for_the_normalised_reference():
    torch.manual_seed(0)
    model, original = UNet("resnet34", 5).eval(), Unet("resnet34", encoder_weights=None, classes=5)
    state = {k.replace("head.", "segmentation_head."): v for k, v in model.state_dict().items()}
    original.load_state_dict(state)
    views = random_views()
    mean, std = (torch.tensor(x)[:, None, None] for x in (IMAGE_MEAN, IMAGE_STD))
    with torch.no_grad():
        expected = original.eval()((views.images[:, 0] - mean) / std)
        torch.testing.assert_close(model(views).logits, expected)


def test_a_trained_u_net_finds_its_place_in_the_plane_sweep_of_its_features(tmp_path: Path):
    trained = build("unet_r34", 3)
    save(trained, tmp_path / "unet.safetensors", "unet_r34")
    model = build("mvs_unet", 20)
    anew = load_into(model, str(tmp_path / "unet.safetensors"))
    assert {name.split(".")[0] for name in anew} == {"cascade", "geometry_encoder"}
    assert not any(part in name for name in anew for part in (".encoder.", ".decoder."))
    own = model.state_dict()
    for name, value in trained.state_dict().items():
        if not name.startswith("head."):
            assert torch.equal(own[f"geometry_encoder.{name}"], value), name


def test_a_run_s_imagenet_file_reaches_the_backbone():
    with pytest.raises(InputError, match=r"'missing\.pth' is not to be had"):
        initial_model(ModelConfig("unet_r34", imagenet="missing.pth"))
