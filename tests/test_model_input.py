"""What models accept: sides that divide, and other pictures for the semantic encoder."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F

from mvsam.types import Views
from tests.small import SIDE, random_views, small_model


@pytest.mark.parametrize(
    "name, height, divisor",
    [("tiny", 48, 32), ("cas_mvsnet", 40, 32), ("sam_conv", 42, 4), ("sam_semantic", 34, 4)],
)
def test_sides_that_do_not_divide_are_refused(name: str, height: int, divisor: int):
    model, views = small_model(name).eval(), random_views(height=height)
    message = rf"images of 64x{height}: both sides must be divisible by {divisor}; resize"
    with pytest.raises(ValueError, match=message):
        model(views)
    with pytest.raises(ValueError, match=message):
        model.encode(views)


def at_sam_size(views: Views) -> Views:
    """The pictures, resized before the model as the encoder itself would."""
    size = (SIDE * views.height // views.width, SIDE)
    images = F.interpolate(views.images[0], size, mode="bilinear", antialias=True)
    return replace(views, semantic_images=images[None])


@pytest.mark.parametrize("name", ["tiny", "sam_semantic"])
def test_photos_at_sam_s_own_size_give_the_features_of_pictures_brought_to_it(name: str):
    model, views = small_model(name).eval(), random_views(height=64, width=128)
    with torch.no_grad():
        expected, actual = model(views), model(at_sam_size(views))
    torch.testing.assert_close(actual.logits, expected.logits, atol=1e-5, rtol=1e-5)


def test_sam_looks_at_the_photos_and_the_cascade_does_not():
    model, views = small_model("base_no_bridge").eval(), random_views(height=32, width=64)
    others = replace(views, semantic_images=torch.rand(1, 3, 3, 48, 64))
    with torch.no_grad():
        without, given = model(views), model(others)
        assert torch.equal(given.depth, without.depth)
        assert given.logits.shape == without.logits.shape
        assert not torch.allclose(given.logits, without.logits, atol=1e-3)
        # What counts is each view's own photo, in whatever place the view stands.
        second = model.encode(others).semantic
        first = model.encode(others.with_reference(1)).semantic
    assert first is not None and second is not None
    first, second = first[:, 0], second[:, 1]
    torch.testing.assert_close(first, second, atol=1e-5, rtol=1e-5)


def test_a_model_trained_with_photos_does_not_run_without():
    model = small_model("tiny").eval()
    model.semantic_size = (64, 48)
    with pytest.raises(ValueError, match=r"set views\.semantic_images"):
        model(random_views())
