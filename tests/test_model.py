"""Every assembly of `build.py` at reduced size: what it predicts, learns and is invariant to."""

from dataclasses import fields, replace
from typing import Any

import pytest
import torch
import torch.nn.functional as F

from mvsam.build import ASSEMBLIES, MODELS, Inputs
from mvsam.geometry.camera import scale_intrinsics
from mvsam.model import Features, MultiViewSAM
from mvsam.training.losses import JointLoss
from mvsam.types import Prediction, Views
from tests.small import (
    random_poses,
    random_targets,
    random_views,
    shuffle_statistics,
    small_model,
)

ALL = list(ASSEMBLIES)
MULTI_VIEW = [name for name in ALL if "depth" in MODELS[name].tasks]
WITH_FROZEN_SAM = [name for name in ALL if "sam" in name or name.startswith("base")]

WITHOUT_GRADIENT = {"decoder.no_depth": "depth is known everywhere in these views"}


@pytest.fixture(scope="module")
def evaluated():
    """Models in evaluation mode by name, each built once."""
    built: dict[str, MultiViewSAM] = {}

    def model(name: str) -> MultiViewSAM:
        if name not in built:
            built[name] = small_model(name).eval()
            shuffle_statistics(built[name])
        return built[name]

    return model


def views_for(name: str, **options) -> Views:
    return random_views(measured=MODELS[name].inputs is Inputs.RGBD, **options)


def predict(model: MultiViewSAM, views: Views) -> Prediction:
    with torch.no_grad():
        return model(views)


def reorder(views: Views, order: list[int]) -> Views:
    return replace(
        views,
        images=views.images[:, order],
        intrinsics=views.intrinsics[:, order],
        world_from_cam=views.world_from_cam[:, order],
    )


def pick(values: Any, item: int) -> Any:
    """One item as a batch of its own."""
    return None if values is None else values[item : item + 1]


def assert_same(actual: Prediction, expected: Prediction, tolerance: float = 1e-4) -> None:
    """Depth in metres, confidence in 0..1, logits as they are."""
    for name in ("depth", "confidence", "logits"):
        a, b = getattr(actual, name), getattr(expected, name)
        assert (a is None) == (b is None)
        if a is not None:
            torch.testing.assert_close(a, b, atol=tolerance, rtol=tolerance)


@pytest.mark.parametrize("name", ALL)
def test_prediction_has_the_model_s_tasks_in_finite_numbers_of_the_photo_s_size(evaluated, name):
    prediction = predict(evaluated(name), views_for(name, batch=2))
    tasks = MODELS[name].tasks
    assert (prediction.depth is not None) == (prediction.confidence is not None)
    assert (prediction.depth is not None) == ("depth" in tasks)
    assert (prediction.logits is not None) == ("semantics" in tasks)
    if prediction.depth is not None and prediction.confidence is not None:
        assert prediction.depth.shape == (2, 32, 64) and prediction.depth.min() >= 0.1 - 1e-6
        assert prediction.confidence.min() >= 0 and prediction.confidence.max() <= 1
        sizes = [stage.depth.shape[-2:] for stage in prediction.stages]
        assert sizes == [(8, 16), (16, 32), (32, 64)]
        assert torch.equal(prediction.stages[-1].depth, prediction.depth)
    if prediction.logits is not None:
        assert prediction.logits.shape == (2, 20, 32, 64) and prediction.logits.isfinite().all()


def train_once(model: MultiViewSAM, name: str) -> None:
    views = views_for(name, batch=2)
    JointLoss()(model(views), random_targets(2), views.depth_range)["loss"].backward()


@pytest.mark.parametrize("name", ALL)
def test_every_trainable_parameter_gets_a_gradient_and_no_frozen_one(name: str):
    options = {"tuned_blocks": 3} if name in WITH_FROZEN_SAM else {}
    model = small_model(name, **options).train()
    train_once(model, name)
    for parameter_name, parameter in model.named_parameters():
        if not parameter.requires_grad:
            assert parameter.grad is None, parameter_name
        elif parameter_name in WITHOUT_GRADIENT and model.prompt is not None:
            assert parameter.grad is None or parameter.grad.eq(0).all(), parameter_name
        else:
            assert parameter.grad is not None, parameter_name
            assert parameter.grad.isfinite().all() and parameter.grad.ne(0).any(), parameter_name


@pytest.mark.parametrize("name", WITH_FROZEN_SAM)
def test_a_frozen_encoder_gets_no_gradient_and_the_rest_does(name: str):
    model = small_model(name, tuned_blocks=0).train()
    train_once(model, name)
    assert model.semantic_encoder is not None
    assert all(p.grad is None for p in model.semantic_encoder.parameters())
    learned = [p for n, p in model.named_parameters() if not n.startswith("semantic_encoder")]
    assert learned and all(p.grad is not None for p in learned)


@pytest.mark.parametrize("passes", [True, False])
def test_segmentation_reaches_the_depth_through_the_prompt_unless_told_not_to(passes: bool):
    model = small_model("base").train()
    model.prompt_passes_gradient = passes
    logits = model(random_views(batch=2)).logits
    assert logits is not None
    logits.square().mean().backward()
    last = dict(model.named_parameters())["cascade.regularizers.2.score.weight"].grad
    assert (last is not None and bool(last.ne(0).any())) == passes


@pytest.mark.parametrize("name", ALL)
def test_state_dict_round_trip_gives_the_same_predictions(evaluated, name: str):
    model, other = evaluated(name), small_model(name, seed=1).eval()
    other.load_state_dict(model.state_dict())
    views = views_for(name)
    assert_same(predict(other, views), predict(model, views), tolerance=0)


@pytest.mark.parametrize("name", ALL)
def test_predictions_repeat_themselves(evaluated, name: str):
    views = views_for(name)
    first, second = (predict(evaluated(name), views) for _ in range(2))
    assert_same(first, second, tolerance=0)


@pytest.mark.parametrize("name", ALL)
def test_batch_items_are_independent(evaluated, name: str):
    views = views_for(name, batch=2)
    both = predict(evaluated(name), views)
    for item in range(2):
        one = Views(*(pick(getattr(views, f.name), item) for f in fields(Views)))
        alone = predict(evaluated(name), one)
        expected = Prediction(
            pick(both.depth, item), pick(both.confidence, item), pick(both.logits, item)
        )
        assert_same(alone, expected)


@pytest.mark.parametrize("name", MULTI_VIEW)
def test_the_order_of_source_views_does_not_matter(evaluated, name: str):
    views = random_views(num_views=4)
    shuffled = reorder(views, [0, 3, 1, 2])
    assert_same(predict(evaluated(name), shuffled), predict(evaluated(name), views), 1e-3)


@pytest.mark.parametrize("name", ["cas_mvsnet", "tiny"])
def test_moving_and_turning_the_world_frame_does_not_matter(evaluated, name: str):
    views = random_views()
    move = random_poses(1, torch.Generator().manual_seed(9), angle=1.0)[0].double()
    moved = replace(views, world_from_cam=(move @ views.world_from_cam.double()).float())
    # The moved poses are rounded to float32 again.
    assert_same(predict(evaluated(name), moved), predict(evaluated(name), views), 1e-3)


@pytest.mark.parametrize("name", ["cas_mvsnet", "tiny"])
@pytest.mark.parametrize("num_views", range(2, 9))
def test_any_number_of_views_from_2_to_8(evaluated, name: str, num_views: int):
    prediction = predict(evaluated(name), random_views(num_views=num_views))
    assert prediction.depth is not None and prediction.depth.isfinite().all()


@pytest.mark.parametrize("size", [(64, 64), (96, 32)])
@pytest.mark.parametrize("name", ["tiny", "base"])
def test_any_image_size_divisible_by_32(evaluated, name: str, size: tuple[int, int]):
    height, width = size
    prediction = predict(evaluated(name), random_views(height=height, width=width))
    assert prediction.depth is not None and prediction.depth.shape == (1, height, width)
    assert prediction.logits is not None and prediction.logits.shape == (1, 20, height, width)


@pytest.mark.parametrize("num_classes", [1, 2, 150])
def test_any_number_of_classes(num_classes: int):
    logits = predict(small_model("tiny", num_classes).eval(), random_views()).logits
    assert logits is not None and logits.shape[1] == num_classes


@pytest.mark.parametrize("name", ["base", "tiny", "cas_mvsnet", "base_no_bridge", "mvs_sam"])
def test_decoding_with_another_reference_equals_reordering_the_views(evaluated, name: str):
    model, views = evaluated(name), random_views(num_views=4)
    with torch.no_grad():
        features = model.encode(views)
        for reference, order in ((1, [1, 0, 2, 3]), (3, [3, 0, 1, 2])):
            decoded = model.decode(features, views, reference)
            assert_same(decoded, model(reorder(views, order)))


@pytest.mark.parametrize("name", ["base", "cas_mvsnet", "sam_semantic"])
def test_views_encoded_one_by_one_and_joined_equal_those_encoded_together(evaluated, name: str):
    model, views = evaluated(name), random_views(num_views=3)
    with torch.no_grad():
        together = model.encode(views)
        joined = Features.join([model.encode(reorder(views, [i])) for i in range(3)])
        assert_same(model.decode(joined, views, 1), model.decode(together, views, 1))
    assert len(joined.pyramid) == len(together.pyramid)
    for a, b in zip(joined.pyramid, together.pyramid, strict=True):
        torch.testing.assert_close(a, b, atol=1e-4, rtol=1e-4)


def test_the_bridge_adds_semantics_to_geometry_at_every_scale(evaluated):
    model, views = evaluated("base"), random_views()
    images = views.images[0]
    with torch.no_grad():
        pyramid = model.encode(views).pyramid
        added = model.bridge(model.semantic_encoder(images))
        for level, geometry, semantics in zip(
            pyramid, model.geometry_encoder(images), added, strict=True
        ):
            torch.testing.assert_close(level[0], geometry + semantics)


@pytest.mark.parametrize("name", ["sam_semantic", "sam_conv", "sam_semantic_gt_depth"])
def test_a_model_of_one_view_looks_at_view_0_alone(evaluated, name: str, monkeypatch):
    model, views = evaluated(name), views_for(name)
    expected = predict(model, reorder(views, [0]))
    seen = []
    encode = model.semantic_encoder.forward
    monkeypatch.setattr(
        model.semantic_encoder,
        "forward",
        lambda x, *rest: (seen.append(len(x)), encode(x, *rest))[1],
    )
    assert_same(predict(model, views), expected)
    assert seen == [1]


def test_measured_depth_prompts_the_decoder(evaluated):
    model, views = evaluated("sam_semantic_gt_depth"), random_views(measured=True)
    assert views.measured_depth is not None
    other = replace(views, measured_depth=views.measured_depth.flip(-1))
    first, second = predict(model, views).logits, predict(model, other).logits
    assert first is not None and second is not None and not torch.equal(first, second)


def test_missing_measured_depth_is_asked_for(evaluated):
    with pytest.raises(ValueError, match=r"set views\.measured_depth"):
        predict(evaluated("sam_semantic_gt_depth"), random_views())


def test_a_model_that_reads_depth_refuses_a_reference_without(evaluated):
    model, views = evaluated("sam_semantic_gt_depth"), random_views(measured=True)
    with torch.no_grad(), pytest.raises(ValueError, match=r"set views\.measured_depth"):
        model.decode(model.encode(views), views, reference=1)


def test_a_plane_sweep_of_one_view_is_refused(evaluated):
    with pytest.raises(ValueError, match="one view: a plane sweep needs a source"):
        predict(evaluated("cas_mvsnet"), random_views(num_views=1))


@pytest.mark.parametrize("reference", [-1, 3])
def test_a_reference_that_is_no_view_is_refused(evaluated, reference: int):
    """-1 would be view 2 as reference and once more among its own sources."""
    model, views = evaluated("cas_mvsnet"), random_views(num_views=3)
    with torch.no_grad(), pytest.raises(ValueError, match=f"reference {reference} of views 0 to 2"):
        model.decode(model.encode(views), views, reference)
    with pytest.raises(ValueError, match="of views 0 to 2"):
        views.with_reference(reference)


def test_measured_depth_of_another_view_goes(evaluated):
    """It belongs to view 0; a model of RGB views never asked for it."""
    model, views = evaluated("cas_mvsnet"), random_views(num_views=3)
    with_depth = replace(views, measured_depth=torch.ones_like(views.images[:, 0, 0]))
    assert with_depth.with_reference(0).measured_depth is not None
    assert with_depth.with_reference(1).measured_depth is None
    with torch.no_grad():
        first, second = (model.decode(model.encode(v), v, 1).depth for v in (views, with_depth))
    assert first is not None and second is not None
    torch.testing.assert_close(first, second)


def test_depth_range_is_each_item_s_own(evaluated):
    model, views = evaluated("cas_mvsnet"), random_views(batch=2)
    ranged = replace(views, depth_range=torch.tensor([[0.1, 5.0], [1.0, 2.0]]))
    prediction = predict(model, ranged)
    first = predict(model, views)
    assert prediction.depth is not None and first.depth is not None
    torch.testing.assert_close(prediction.depth[0], first.depth[0])
    coarse = prediction.stages[0].hypotheses
    assert coarse[1].min() == 1.0 and coarse[1].max() == 2.0


def test_labelling_a_photo_alone_equals_predicting_it_with_its_own_depth_as_measurement(evaluated):
    model, views = evaluated("tiny"), random_views()
    whole = predict(model, views)
    assert whole.depth is not None and whole.logits is not None
    with torch.no_grad():
        alone = model.segment(replace(views, measured_depth=whole.depth))
    assert alone.depth is None and alone.logits is not None
    torch.testing.assert_close(alone.logits, whole.logits, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize(
    "part", ["bridge", "cascade", "prior", "context", "prompt", "decoder", "geometry_encoder"]
)
def test_a_part_without_its_counterpart_is_refused(part: str):
    lone = getattr(small_model("tiny"), part)
    with pytest.raises(ValueError, match=f"the {part} needs"):
        MultiViewSAM(**{part: lone})


def test_a_convolutional_decoder_is_given_no_prompt():
    parts, decoder = small_model("tiny"), small_model("tiny_sam_conv").decoder
    with pytest.raises(ValueError, match="takes no prompt"):
        MultiViewSAM(semantic_encoder=parts.semantic_encoder, prompt=parts.prompt, decoder=decoder)


def test_a_model_without_a_decoder_cannot_label_photos(evaluated):
    with pytest.raises(ValueError, match="no decoder"):
        evaluated("cas_mvsnet").segment(random_views(measured=True))


@pytest.mark.parametrize("size", [(96, 96), (64, 96)])
def test_larger_pictures_serve_the_later_sweeps_alone(size: tuple[int, int]):
    model = small_model("tiny").eval()
    shuffle_statistics(model)
    model.input_size = (64, 64)
    large = random_views(height=size[0], width=size[1])
    images = F.interpolate(large.images[0], (64, 64), mode="bilinear", antialias=True)[None]
    intrinsics = scale_intrinsics(large.intrinsics, 64 / size[1], 64 / size[0])
    small = replace(large, images=images, intrinsics=intrinsics, measured_depth=None)
    of_large, of_small = predict(model, large), predict(model, small)
    sizes = [stage.depth.shape[-2:] for stage in of_large.stages]
    assert sizes == [(16, 16), (size[0] // 2, size[1] // 2), size]
    torch.testing.assert_close(
        of_large.stages[0].probability, of_small.stages[0].probability, atol=1e-4, rtol=1e-3
    )
    assert of_large.prior is not None and of_small.prior is not None
    torch.testing.assert_close(of_large.prior, of_small.prior, atol=1e-4, rtol=1e-3)
    for maps in (of_large.depth, of_large.confidence, of_large.logits):
        assert maps is not None and maps.shape[-2:] == size
    model.has_finer_sweeps = False
    assert predict(model, large).stages[0].depth.shape[-1] == 24


def test_larger_pictures_are_labelled_as_those_of_the_learned_size():
    model = small_model("tiny").eval()
    model.input_size = (64, 64)
    large = random_views(height=96, width=96, measured=True)
    prediction = model.segment(large)
    assert prediction.logits is not None and prediction.logits.shape[-2:] == (96, 96)
    assert prediction.prior is not None and prediction.prior.log_median.shape[-2:] == (16, 16)
