import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import nn

from mvsam.mvs.cascade import (
    DepthCascade,
    combined_confidence,
    four_plane_mass,
    regress,
    smoothed,
)
from mvsam.mvs.regularizer import CostRegularizer
from mvsam.mvs.votes import Scoring, joint_scores, voted_scores
from mvsam.types import DepthStage, Views
from tests import synthetic
from tests.reference import plane_sweep
from tests.small import random_views


def pyramid(views, channels=(32, 16, 8)):
    shape = views.images.shape[:2]
    return [
        torch.randn(*shape, c, views.height // scale, views.width // scale)
        for c, scale in zip(channels, (4, 2, 1), strict=True)
    ]


def flat_scores(module: nn.Module) -> None:
    if isinstance(module, CostRegularizer):
        module.score.weight.data.zero_()


def cascade(**options) -> DepthCascade:
    torch.manual_seed(0)
    return DepthCascade([CostRegularizer(channels) for channels in (32, 16, 8)], **options).eval()


def test_eq_3_equals_the_slow_twin():
    scores, hypotheses = 3 * torch.randn(1, 6, 4, 5), 1 + torch.rand(1, 6, 4, 5)
    stage = regress(scores, hypotheses)
    expected = plane_sweep.expected_depth(scores[0].double().numpy(), hypotheses[0].numpy())
    np.testing.assert_allclose(stage.depth[0], expected, rtol=1e-5)
    torch.testing.assert_close(stage.probability.sum(1), torch.ones(1, 4, 5))


def test_expected_depth_lies_inside_its_hypotheses():
    hypotheses = torch.rand(2, 8, 4, 4)
    depth = regress(20 * torch.randn(2, 8, 4, 4), hypotheses).depth
    assert (depth >= hypotheses.amin(1)).all() and (depth <= hypotheses.amax(1) + 1e-6).all()


@pytest.mark.parametrize("num_planes", [2, 3, 8, 48])
@pytest.mark.parametrize("sharpness", [0.0, 1.0, 8.0])
def test_four_plane_mass_equals_the_slow_twin(num_planes: int, sharpness: float):
    generator = torch.Generator().manual_seed(num_planes)
    scores = sharpness * torch.randn(1, num_planes, 4, 5, generator=generator)
    # A tilt keeps the expected index off whole numbers, where rounding would choose the floor.
    scores = scores + 0.01 * torch.arange(num_planes)[:, None, None]
    probability = torch.softmax(scores.double(), dim=1)
    expected = plane_sweep.four_plane_mass(probability[0].numpy())
    np.testing.assert_allclose(four_plane_mass(probability)[0], expected, atol=1e-9)


def test_all_mass_on_one_plane_is_full_confidence():
    for plane in (0, 5, 9):
        probability = torch.zeros(1, 10, 1, 1)
        probability[:, plane] = 1
        assert four_plane_mass(probability).item() == 1.0


def test_confidence_carries_no_gradient():
    scores = torch.randn(1, 8, 2, 2, requires_grad=True)
    stage = regress(scores, torch.rand(1, 8, 2, 2))
    assert stage.depth.requires_grad and not stage.confidence.requires_grad


def sure(confidence: torch.Tensor) -> DepthStage:
    return DepthStage(confidence[:, None], confidence[:, None], confidence, confidence)


def test_combined_confidence_is_the_product_of_the_stages_but_the_last():
    stages = [sure(torch.full((1, side, side), mass)) for side, mass in [(2, 0.5), (4, 0.8)]]
    last = sure(torch.rand(1, 8, 8))
    product = combined_confidence([*stages, last], (8, 8))
    torch.testing.assert_close(product, torch.full((1, 8, 8), 0.4))
    alone = combined_confidence([sure(torch.full((1, 8, 8), 0.3))], (8, 8))
    torch.testing.assert_close(alone, torch.full((1, 8, 8), 0.3))


@pytest.mark.parametrize(("side", "window"), [(64, 17), (32, 9), (16, 5)])
def test_confidence_is_a_mean_over_as_much_of_the_picture_in_every_stage(side: int, window: int):
    mass = torch.rand(1, side, side)
    means = smoothed(mass, (64, 64))
    corner = mass[0, : window // 2 + 1, : window // 2 + 1]  # what lies outside does not count
    torch.testing.assert_close(means[0, 0, 0], corner.mean())


def test_smoothing_spreads_one_pixel_evenly():
    mass = torch.zeros(1, 64, 64)
    mass[0, 30, 40] = 1
    spread = torch.zeros(1, 64, 64)
    spread[0, 22:39, 32:49] = 1 / 17**2
    torch.testing.assert_close(smoothed(mass, (64, 64)), spread)


def test_uniform_scores_give_the_middle_of_the_range_everywhere():
    model, views = cascade().apply(flat_scores), random_views()
    with torch.no_grad():
        stages = model(pyramid(views), views)
    for stage in stages:
        torch.testing.assert_close(stage.depth, torch.full_like(stage.depth, 2.55))
    assert [s.hypotheses.shape[1:] for s in stages] == [(48, 8, 16), (32, 16, 32), (8, 32, 64)]
    assert [s.confidence.mean().item() for s in stages] == pytest.approx([4 / 48, 4 / 32, 4 / 8])


def near_surface(clamp) -> list[DepthStage]:
    """Every stage's best plane is its nearest."""
    model = cascade(clamp=clamp)
    views = random_views()

    def nearest(volume):
        scores = torch.zeros_like(volume[:, 0])
        scores[:, 0] = 50
        return scores

    for regularizer in model.regularizers:
        regularizer.forward = nearest
    return model(pyramid(views), views)


def test_shifted_windows_never_begin_before_d_min():
    stages = near_surface("shift")
    assert all(stage.hypotheses.min() >= 0.1 - 1e-6 for stage in stages)
    assert stages[2].depth.min() == pytest.approx(0.1, abs=1e-5)


def test_unclamped_windows_become_negative_near_the_camera():
    assert near_surface("none")[1].hypotheses.min() < 0


def test_no_gradient_flows_from_a_stage_to_the_one_before():
    model, views = cascade(), random_views()
    features = [level.requires_grad_() for level in pyramid(views)]
    model(features, views)[1].depth.sum().backward()
    assert features[0].grad is None and features[1].grad is not None


def test_a_cascade_of_unequal_lists_is_refused():
    with pytest.raises(ValueError, match="as many regularizers"):
        DepthCascade([CostRegularizer(8)], num_planes=(8, 8), interval_ratios=(1.0,))


@pytest.mark.parametrize("first_scores", [joint_scores, voted_scores])
def test_checkpointed_stages_train_the_same(first_scores: Scoring):
    views = random_views()
    levels = pyramid(views)
    kept = cascade(first_scores=first_scores).train()
    recomputed = cascade(first_scores=first_scores, checkpoint_stages=True).train()
    for model in (kept, recomputed):
        torch.stack([stage.depth.mean() for stage in model(levels, views)]).sum().backward()
    ours, theirs = dict(recomputed.named_parameters()), dict(kept.named_parameters())
    for name, parameter in theirs.items():
        torch.testing.assert_close(ours[name].grad, parameter.grad)
    for name, statistic in kept.named_buffers():  # a batch seen twice counts once
        assert torch.equal(recomputed.get_buffer(name), statistic), name


def test_checkpointed_stages_keep_no_volume_for_the_backward_pass():
    views = random_views()
    levels = [level.requires_grad_() for level in pyramid(views)]

    def kept_bytes(model: DepthCascade) -> int:
        sizes: dict[int, int] = {}

        def note(tensor: torch.Tensor) -> torch.Tensor:
            storage = tensor.untyped_storage()
            sizes[storage.data_ptr()] = storage.nbytes()
            return tensor

        with torch.autograd.graph.saved_tensors_hooks(note, lambda tensor: tensor):
            model(levels, views)
        return sum(sizes.values())

    plain = kept_bytes(cascade().train())
    assert kept_bytes(cascade(checkpoint_stages=True).train()) < plain / 5


def matching_score(volume: torch.Tensor) -> torch.Tensor:
    """What a regularizer learns, without learning: agreement of the views around each pixel."""
    cost = F.avg_pool2d(volume.sum(1), 5, stride=1, padding=2, count_include_pad=False)
    return -2e4 * cost


def test_plain_matching_finds_the_true_depth_of_a_room():
    truth = synthetic.synthetic_views(num_frames=3, size=(128, 96), baseline=0.1)
    images = np.stack([view.image for view in truth]).astype(np.float32) / 255
    views = Views(
        torch.from_numpy(images).permute(0, 3, 1, 2)[None],
        torch.from_numpy(np.stack([view.intrinsics for view in truth])).float()[None],
        torch.from_numpy(np.stack([view.world_from_cam for view in truth])).float()[None],
        torch.tensor([[0.5, 5.0]]),
    )
    model = cascade()
    for regularizer in model.regularizers:
        regularizer.forward = matching_score
    levels = [
        F.avg_pool2d(views.images[0], scale)[None] if scale > 1 else views.images
        for scale in (4, 2, 1)
    ]
    stages = model(levels, views)
    depth = torch.from_numpy(truth[0].depth)[None]
    errors = []
    for stage in stages:
        true = F.interpolate(depth[:, None], stage.depth.shape[-2:], mode="nearest-exact")[:, 0]
        inner = (slice(None), slice(2, -2), slice(2, -2))
        errors.append(((stage.depth - true).abs() / true)[inner].median().item())
    # A texture of some centimetres, seen from 10 cm apart: half a pixel is about 1 % of depth.
    assert errors[0] < 0.03 and errors[1] < 0.01 and errors[2] < 0.01
