"""The Triton sweep against its specification, on a GPU or by Triton's interpreter (conftest.py)."""

import os
import re
import subprocess
import sys

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode

from mvsam.geometry.warp import project_hypotheses, source_from_reference_pixels
from mvsam.mvs import cost_volume
from mvsam.mvs.cost_volume import textbook_variance_volume
from tests.mvs.test_cost_volume import problem
from tests.mvs.test_sweep import outputs_and_gradients

pytest.importorskip("triton")
sweep_triton = pytest.importorskip("mvsam.mvs.sweep_triton")

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"


def triton_variance_volume(features, intrinsics, world_from_cam, hypotheses):
    projections = cost_volume.sweep_projections(intrinsics, world_from_cam)
    return sweep_triton.sweep_variance(features, projections, hypotheses)


def arguments_and_incoming(num_views=3, channels=8, planes=2, height=4, width=5, batch=1, seed=0):
    arguments = problem(num_views, channels, planes, height, width, batch, seed)
    incoming = torch.randn(batch, channels, planes, height, width)
    return tuple(x.to(DEVICE) for x in arguments), incoming.to(DEVICE)


@pytest.mark.parametrize(
    ("num_views", "channels", "planes", "height", "width", "batch"),
    [
        (1, 8, 1, 3, 4, 1),
        (2, 8, 9, 3, 5, 1),  # planes for two programs, the second nearly empty
        (3, 5, 2, 4, 7, 2),  # channels that fill no power of two
        (4, 16, 1, 5, 7, 1),  # pixels for two programs
        (5, 32, 1, 1, 17, 1),
    ],
)
def test_equals_the_textbook(num_views, channels, planes, height, width, batch):
    sizes = (num_views, channels, planes, height, width, batch)
    arguments, incoming = arguments_and_incoming(*sizes, seed=num_views)
    fast = outputs_and_gradients(triton_variance_volume, arguments, incoming)
    slow = outputs_and_gradients(textbook_variance_volume, arguments, incoming)
    # Coordinates of some ten pixels, worked out in another order in float32.
    torch.testing.assert_close(fast[0], slow[0], atol=2e-4, rtol=1e-4)
    torch.testing.assert_close(fast[1], slow[1], atol=5e-4, rtol=1e-4)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_half_precision_is_rounded_once(dtype: torch.dtype):
    (features, *cameras), incoming = arguments_and_incoming()
    arguments, incoming = (features.to(dtype), *cameras), incoming.to(dtype)
    fast = outputs_and_gradients(triton_variance_volume, arguments, incoming)
    slow = outputs_and_gradients(textbook_variance_volume, arguments, incoming)
    assert fast[0].dtype == fast[1].dtype == dtype
    # Both are worked out in float32, so they differ by one step at most.
    step = torch.finfo(dtype).eps
    torch.testing.assert_close(fast[0], slow[0], atol=1e-3, rtol=step)
    torch.testing.assert_close(fast[1], slow[1], atol=1e-3, rtol=step)


def test_samples_behind_cameras_and_outside_views_are_zeros_without_gradient():
    (features, intrinsics, poses, hypotheses), incoming = arguments_and_incoming(
        num_views=4, planes=3, height=5, width=6, seed=3
    )
    generator = torch.Generator().manual_seed(1)
    poses[:, 1:, :3, :3] = torch.linalg.qr(torch.randn(1, 3, 3, 3, generator=generator)).Q
    poses[:, 1:, :3, 3] = torch.randn(1, 3, 3, generator=generator)
    arguments = (features, intrinsics, poses, hypotheses)
    assert_every_case_occurs(intrinsics, poses, hypotheses)
    fast = outputs_and_gradients(triton_variance_volume, arguments, incoming)
    slow = outputs_and_gradients(
        textbook_variance_volume, tuple(x.double() for x in arguments), incoming.double()
    )
    # A point close to the plane of a source camera has coordinates of hundreds of pixels.
    torch.testing.assert_close(fast[0].double(), slow[0], atol=5e-3, rtol=0)
    torch.testing.assert_close(fast[1].double(), slow[1], atol=2e-2, rtol=0)


def assert_every_case_occurs(intrinsics, poses, hypotheses):
    """Points behind a camera, beside its picture, across the picture's edge, and inside."""
    height, width = hypotheses.shape[-2:]
    beside, across, inside, behind = 0, 0, 0, 0
    for view in range(1, poses.shape[1]):
        linear, offset = source_from_reference_pixels(intrinsics, poses, view)
        uv, in_front = project_hypotheses(linear, offset, hypotheses)
        size = uv.new_tensor([width, height])
        whole = ((uv >= 0.5) & (uv <= size - 0.5)).all(-1)  # all four neighbours exist
        some = ((uv > -0.5) & (uv < size + 0.5)).all(-1)
        behind += int((~in_front).sum())
        beside += int((in_front & ~some).sum())
        across += int((in_front & some & ~whole).sum())
        inside += int((in_front & whole).sum())
    assert min(beside, across, inside, behind) > 5


def test_expanded_planes_and_an_expanded_gradient_are_read_right():
    (features, intrinsics, poses, _), _ = arguments_and_incoming()
    planes = torch.tensor([[0.5, 1.5]], device=DEVICE)[:, :, None, None].expand(-1, -1, 4, 5)
    one = torch.ones((), device=DEVICE).expand(1, 8, 2, 4, 5)
    arguments = (features, intrinsics, poses, planes)
    fast = outputs_and_gradients(triton_variance_volume, arguments, one)
    slow = outputs_and_gradients(textbook_variance_volume, arguments, one)
    torch.testing.assert_close(fast, slow, atol=5e-4, rtol=1e-4)


def test_autocast_changes_neither_the_type_nor_the_figures():
    (features, *cameras), _ = arguments_and_incoming()
    plain = triton_variance_volume(features, *cameras)
    with torch.autocast(DEVICE, torch.bfloat16):
        cast = triton_variance_volume(features, *cameras)
    assert cast.dtype == torch.float32
    assert torch.equal(cast, plain)


@pytest.mark.filterwarnings("ignore:The .grad attribute")  # torch's own check reads it
def test_torch_can_trace_and_compile_it():
    features = torch.randn(1, 2, 3, 4, 8, device=DEVICE, requires_grad=True)
    cameras = torch.rand(1, 2, 12, device=DEVICE), torch.rand(1, 2, 3, 4, device=DEVICE)
    torch.library.opcheck(torch.ops.mvsam.sweep_variance.default, (features, *cameras))


def test_a_second_derivative_is_refused():
    features = torch.randn(1, 2, 4, 2, 3, device=DEVICE, requires_grad=True)
    cameras = torch.rand(1, 2, 12, device=DEVICE), torch.rand(1, 1, 2, 3, device=DEVICE)
    volume = sweep_triton.sweep_variance(features, *cameras)
    (gradient,) = torch.autograd.grad(volume.square().sum(), features, create_graph=True)
    with pytest.raises(RuntimeError, match="no autograd formula"):
        gradient.sum().backward()


def gpu_problem(dtype=torch.bfloat16):
    """Shapes only: a `FakeTensor` is on a GPU that need not exist."""
    features = torch.empty(1, 3, 8, 6, 7, device="cuda", dtype=dtype)
    cameras = torch.empty(1, 3, 3, 3, device="cuda"), torch.empty(1, 3, 4, 4, device="cuda")
    return features, *cameras, torch.empty(1, 5, 6, 7, device="cuda")


def test_problems_on_a_gpu_are_swept_by_triton(monkeypatch):
    def is_fused(dtype: torch.dtype) -> bool:
        features, *_, hypotheses = gpu_problem(dtype)
        return cost_volume._fused_sweep(features, hypotheses) is sweep_triton.sweep_variance

    with FakeTensorMode():
        volume = cost_volume.variance_volume(*gpu_problem())
        assert volume.shape == (1, 8, 5, 6, 7)
        assert volume.is_contiguous(memory_format=torch.channels_last_3d)
        assert is_fused(torch.float32) and is_fused(torch.float16)
        assert not is_fused(torch.float64)
        monkeypatch.setenv("MVSAM_KERNEL", "0")
        assert not is_fused(torch.float32)
        monkeypatch.undo()
        monkeypatch.setattr(torch, "are_deterministic_algorithms_enabled", lambda: True)
        assert not is_fused(torch.float32)


def print_memory_accesses() -> None:
    """Bytes of shared memory, then the kinds of access to the GPU's memory, a line a kernel."""
    from triton import compile
    from triton.backends.compiler import GPUTarget
    from triton.compiler import ASTSource

    constants = {"channels": 32, "tile_pixels": 16, "tile_channels": 32, "tile_planes": 8}
    types = dict.fromkeys(constants, "constexpr")
    types |= dict.fromkeys(("features", "volume", "incoming"), "*bf16")
    types |= dict.fromkeys(("projections", "hypotheses", "gradient"), "*fp32")
    for kernel in (sweep_triton._variance_kernel, sweep_triton._gradient_kernel):
        signature = {name: types.get(name, "i32") for name in kernel.arg_names}
        pointers = [i for i, kind in enumerate(signature.values()) if kind.startswith("*")]
        source = ASTSource(
            kernel, signature, constants, {(i,): [["tt.divisibility", 16]] for i in pointers}
        )
        compiled = compile(source, target=GPUTarget("cuda", 90, 32))
        accesses = re.findall(r"(?:ld|st|atom)\.global\S*", compiled.asm["ptx"])
        print(compiled.metadata.shared, *sorted(set(accesses)))


def test_compiled_for_a_gpu_no_value_changes_hands_between_threads():
    """The layout that the module argues for, as Triton compiles it; that needs no GPU."""
    script = "from tests.mvs.test_sweep_triton import print_memory_accesses as f; f()"
    environment = {**os.environ, "TRITON_INTERPRET": "0"}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    forward, backward = done.stdout.splitlines()
    # No shared memory; four bfloat16 (two words of 32 bits) at once, four float32 at once.
    assert forward == "0 ld.global.b32 ld.global.v2.b32 st.global.v2.b32"
    assert backward == "0 atom.global.gpu.relaxed.add.v4.f32 ld.global.b32 ld.global.v2.b32"
