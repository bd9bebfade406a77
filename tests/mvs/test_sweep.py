"""The compiled plane sweep against its specification, `textbook_variance_volume`."""

import logging
from pathlib import Path

import pytest
import torch

from mvsam.kernels import load_kernel
from mvsam.mvs import sweep
from mvsam.mvs.cost_volume import textbook_variance_volume, variance_volume
from tests.mvs.test_cost_volume import problem
from tests.small import random_views, small_model

needs_kernel = pytest.mark.skipif(
    load_kernel(sweep.SOURCE) is None,
    reason="no C++ compiler here, so there is no kernel to compare",
)


@pytest.fixture(params=[1, 2])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


@pytest.fixture
def fresh_kernel():
    """Lets a test load the kernel anew under other conditions."""
    load_kernel.cache_clear()
    yield
    load_kernel.cache_clear()


def outputs_and_gradients(volume, arguments, incoming):
    features, *cameras = arguments
    features = features.clone().requires_grad_()
    variance = volume(features, *cameras)
    variance.backward(incoming)
    assert features.grad is not None
    return variance.detach(), features.grad


@needs_kernel
@pytest.mark.parametrize("channels", sweep.KERNEL_CHANNELS)
@pytest.mark.parametrize("num_views", [2, 5, 8])
def test_kernel_equals_the_textbook(channels: int, num_views: int, threads: int):
    arguments = problem(num_views, channels, height=9, width=13, batch=2, seed=num_views)
    incoming = torch.randn(2, channels, 4, 9, 13)
    assert sweep.fits_kernel(arguments[0], arguments[3])
    fast = outputs_and_gradients(variance_volume, arguments, incoming)
    slow = outputs_and_gradients(textbook_variance_volume, arguments, incoming)
    # Coordinates of some ten pixels, worked out in another order in float32.
    torch.testing.assert_close(fast[0], slow[0], atol=2e-4, rtol=1e-4)
    torch.testing.assert_close(fast[1], slow[1], atol=5e-4, rtol=1e-4)


@needs_kernel
def test_kernel_equals_the_textbook_in_bfloat16(threads: int):
    features, *cameras = problem(num_views=3, channels=16, height=9, width=13)
    features = features.bfloat16()
    incoming = torch.randn(1, 16, 4, 9, 13).bfloat16()
    fast = outputs_and_gradients(variance_volume, (features, *cameras), incoming)
    slow = outputs_and_gradients(textbook_variance_volume, (features, *cameras), incoming)
    assert fast[0].dtype == fast[1].dtype == torch.bfloat16
    # Both are worked out in float32 and rounded once: one step of bfloat16, 1/128 of the value.
    torch.testing.assert_close(fast[0], slow[0], atol=1e-3, rtol=1 / 64)
    torch.testing.assert_close(fast[1], slow[1], atol=1e-3, rtol=1 / 64)


@needs_kernel
@pytest.mark.parametrize("volume", [variance_volume, textbook_variance_volume])
def test_kernel_and_textbook_agree_with_cameras_all_over_the_room(volume):
    features, intrinsics, poses, hypotheses = problem(num_views=8, height=9, width=13, seed=3)
    poses[:, 1:, :3, :3] = torch.linalg.qr(torch.randn(1, 7, 3, 3)).Q
    poses[:, 1:, :3, 3] = torch.randn(1, 7, 3)
    incoming = torch.randn(1, 8, 4, 9, 13)
    arguments = (features, intrinsics, poses, hypotheses)
    actual = outputs_and_gradients(volume, arguments, incoming)
    expected = outputs_and_gradients(
        textbook_variance_volume,
        tuple(x.double() for x in arguments),
        incoming.double(),
    )
    # A point close to the plane of a source camera has coordinates of hundreds of pixels.
    torch.testing.assert_close(actual[0].double(), expected[0], atol=5e-3, rtol=0)
    torch.testing.assert_close(actual[1].double(), expected[1], atol=2e-2, rtol=0)


@needs_kernel
def test_kernel_takes_planes_that_are_expanded_views_of_one_number():
    features, intrinsics, poses, _ = problem(height=8, width=8)
    planes = torch.tensor([[0.5, 1.0, 2.0]])[:, :, None, None].expand(-1, -1, 8, 8)
    torch.testing.assert_close(
        variance_volume(features, intrinsics, poses, planes),
        variance_volume(features, intrinsics, poses, planes.contiguous()),
        atol=0,
        rtol=0,
    )


def test_other_problems_are_left_to_the_textbook():
    features, _, _, hypotheses = problem(channels=8)
    assert not sweep.fits_kernel(features.double(), hypotheses)
    assert not sweep.fits_kernel(features[:, :, :5], hypotheses)
    too_many = features[:, :1].expand(-1, sweep.MAXIMUM_VIEWS + 1, -1, -1, -1)
    assert not sweep.fits_kernel(too_many, hypotheses)


@needs_kernel
def test_prediction_is_the_same_with_the_kernel_switched_off(monkeypatch, fresh_kernel):
    model, views = small_model("cas_mvsnet").eval(), random_views()
    with torch.no_grad():
        fast = model(views)
        monkeypatch.setenv("MVSAM_KERNEL", "0")
        load_kernel.cache_clear()
        assert load_kernel(sweep.SOURCE) is None
        slow = model(views)
    # Random weights at a random picture: scores are flat, so depth moves little.
    torch.testing.assert_close(fast.depth, slow.depth, atol=1e-3, rtol=0)
    torch.testing.assert_close(fast.confidence, slow.confidence, atol=1e-3, rtol=0)


def test_a_broken_compiler_falls_back_with_a_warning(monkeypatch, fresh_kernel, tmp_path, caplog):
    broken = tmp_path / "c++"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("MVSAM_CACHE", str(tmp_path / "cache"))
    with caplog.at_level(logging.WARNING):
        assert load_kernel(sweep.SOURCE) is None
    assert "could not be built" in caplog.text
    arguments = problem()
    assert torch.equal(variance_volume(*arguments), textbook_variance_volume(*arguments))


def homeless() -> Path:
    """What `Path.home` does for a user id that no account belongs to, without $HOME."""
    raise RuntimeError("Could not determine home directory.")


def test_a_user_without_a_home_gets_the_textbook_and_a_warning(monkeypatch, fresh_kernel, caplog):
    monkeypatch.delenv("MVSAM_CACHE", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    with caplog.at_level(logging.WARNING):
        assert load_kernel(sweep.SOURCE) is None
    assert "home directory" in caplog.text


@needs_kernel
def test_a_user_without_a_home_may_name_the_kernels_folder(monkeypatch, fresh_kernel, tmp_path):
    monkeypatch.setenv("MVSAM_CACHE", str(tmp_path))
    monkeypatch.setattr(Path, "home", homeless)
    assert load_kernel(sweep.SOURCE) is not None


def test_without_a_compiler_the_textbook_serves(monkeypatch, fresh_kernel, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("MVSAM_CACHE", str(tmp_path / "cache"))
    assert load_kernel(sweep.SOURCE) is None
    assert variance_volume(*problem()).isfinite().all()
