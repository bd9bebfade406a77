"""The yardstick computes what the product computes."""

import torch
from torch import nn

from mvsam.mvs.textbook import TextbookCascade, textbook_regress
from tests.small import random_views, shuffle_statistics, small_model


def test_the_textbook_cascade_gives_the_same_stages():
    model = small_model("cas_mvsnet").eval()
    shuffle_statistics(model)
    views = random_views(num_views=3, height=64, width=64)
    assert model.cascade is not None
    with torch.inference_mode():
        pyramid = model.encode(views).pyramid
        ours, plain = model.cascade(pyramid, views), TextbookCascade(model.cascade)(pyramid, views)
    for mine, theirs in zip(ours, plain, strict=True):
        # Millimetres: float32 sums in another order, sharpened by two refinements.
        torch.testing.assert_close(mine.depth, theirs.depth, atol=2e-3, rtol=0)
        torch.testing.assert_close(mine.probability, theirs.probability, atol=2e-3, rtol=0)


def test_the_textbook_cascade_shares_the_weights_it_is_made_from():
    cascade = small_model("cas_mvsnet").cascade
    assert cascade is not None
    textbook = TextbookCascade(cascade)
    assert list(textbook.state_dict()) == list(cascade.state_dict())
    theirs = zip(textbook.parameters(), cascade.parameters(), strict=True)
    assert all(mine is their for mine, their in theirs)
    convolutions = [m for m in textbook.modules() if isinstance(m, nn.Conv3d | nn.ConvTranspose3d)]
    assert len(convolutions) == 3 * 11
    assert {type(m) for m in convolutions} == {nn.Conv3d, nn.ConvTranspose3d}


def test_confidence_is_the_mass_of_the_four_planes_around_the_expectation():
    probability = torch.tensor([0.05, 0.1, 0.3, 0.25, 0.2, 0.1])  # expected plane 2.75: 1 to 4
    hypotheses = torch.arange(1.0, 7.0)
    stage = textbook_regress(probability.log().view(1, 6, 1, 1), hypotheses.view(1, 6, 1, 1))
    torch.testing.assert_close(stage.depth.item(), 3.75)
    torch.testing.assert_close(stage.confidence.item(), 0.85)
