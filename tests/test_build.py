import pytest
import torch

from mvsam.build import ASSEMBLIES, MODELS, Inputs, build, count_parameters, model_spec
from mvsam.errors import InputError
from mvsam.model import MultiViewSAM

PARAMETERS = {
    "base": 94_220_588,
    "base_no_bridge": 94_120_300,
    "mvs_sam": 90_705_504,
    "mvs_unet": 25_373_216,
    "cas_mvsnet": 934_304,
    "trans_mvsnet": 1_148_924,
    "mvs2d": 14_852_849,
    "mvs2d_multiscale": 26_256_433,
    "unet_r34": 24_439_124,
    "mt_refinenet": 3_023_957,
    "pad_net": 7_008_776,
    "mti_net": 8_567_279,
    "mtan": 72_047_573,
    "segnet": 29_454_548,
    "deeplab_v2": 43_974_800,
    "deeplab_v3": 58_630_740,
    "adapnet_pp": 30_163_830,
    "fusenet": 44_176_532,
    "emsaformer": 70_758_680,
    "emsaformer_mlp": 52_552_924,
    "ssma": 56_200_892,
    "unet_r50": 32_523_860,
    "sam_conv": 89_745_524,
    "sam_semantic": 93_181_312,
    "sam_semantic_gt_depth": 93_185_996,
}


@pytest.mark.parametrize("name, count", PARAMETERS.items())
def test_parameters_of_the_paper_s_rows_are_exact(name: str, count: int):
    assert count_parameters(name) == count


def test_tiny_fits_in_15_megabytes_of_half_precision():
    assert 2 * count_parameters("tiny") < 15e6


def test_counting_allocates_nothing_and_leaves_no_device_behind():
    count_parameters("cas_mvsnet")
    assert torch.empty(1).device.type == "cpu"


@pytest.mark.parametrize("name", MODELS)
def test_every_entry_says_what_it_is(name: str):
    spec = MODELS[name]
    assert spec.name == name and spec.paper_row and spec.inputs and spec.tasks
    assert all(side % 32 == 0 for side in spec.input_size)


@pytest.mark.parametrize("name", ASSEMBLIES)
def test_tasks_are_those_of_the_assembly(name: str):
    with torch.device("meta"):
        model = build(name)
    assert isinstance(model, MultiViewSAM)
    has = {"depth": model.cascade is not None, "semantics": model.decoder is not None}
    assert set(MODELS[name].tasks) == {task for task, present in has.items() if present}


@pytest.mark.parametrize("name", MODELS)
def test_a_model_knows_whether_it_reads_measured_depth(name: str):
    with torch.device("meta"):
        assert build(name).reads_depth == (model_spec(name).inputs is Inputs.RGBD)


def test_an_unknown_name_is_refused_with_the_nearest_and_all_others():
    with pytest.raises(
        InputError, match=r"unknown model 'cas_mvs'.*Did you mean 'cas_mvsnet'"
    ) as e:
        model_spec("cas_mvs")
    assert all(name in str(e.value) for name in MODELS)
    with pytest.raises(InputError) as e:
        build("zzz")
    assert "Did you mean" not in str(e.value)


def test_tuned_blocks_choose_what_of_sam_learns():
    def learned(**options) -> int:
        with torch.device("meta"):
            model = build("sam_semantic", **options)
        assert isinstance(model, MultiViewSAM) and model.semantic_encoder is not None
        return sum(p.numel() for p in model.semantic_encoder.parameters() if p.requires_grad)

    assert learned() == 0
    assert learned(tuned_blocks=3) == 21_286_784 + 787_456  # three blocks and the neck
