import torch

from mvsam import precision


def product_type(name: precision.Precision) -> torch.dtype:
    with precision.autocast("cpu", name):
        return (torch.ones(2, 2) @ torch.ones(2, 2)).dtype


def test_precision_by_name_is_what_it_says():
    assert product_type("float32") == torch.float32
    assert product_type("bfloat16") == torch.bfloat16


def test_auto_follows_the_hardware(monkeypatch):
    for has_it, expected in ((True, torch.bfloat16), (False, torch.float32)):
        monkeypatch.setattr(precision, "has_native_bfloat16", lambda _, answer=has_it: answer)
        assert product_type("auto") == expected


def test_a_processor_is_asked_for_its_own_instructions():
    flags = torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()
    assert precision.has_native_bfloat16("cpu") == flags
