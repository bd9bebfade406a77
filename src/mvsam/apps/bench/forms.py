"""The two ways to run the same weights: as the product does, and as published code does."""

from collections.abc import Callable
from dataclasses import dataclass

from mvsam.apps.bench.cases import Case, FormName
from mvsam.build import build
from mvsam.convolution import fold_batch_norm
from mvsam.encoders.attention import use_plain_attention
from mvsam.memory import keep_freed_memory
from mvsam.model import MultiViewSAM
from mvsam.mvs.textbook import TextbookCascade
from mvsam.types import Model, Prediction, Views
from mvsam.weights import layout_channels_last


@dataclass(frozen=True)
class Form:
    """How a model is made ready, and how it takes its first views as reference in turn."""

    prepare: Callable[[Case], Model]
    predict: Callable[[Model, Views, int], list[Prediction]]


def our_model(case: Case) -> Model:
    """Random weights as a `Session` makes them ready for predictions, `mvsam train` for steps."""
    model = layout_channels_last(build_case(case))
    if case.work == "predict":
        return fold_batch_norm(model)
    if case.device == "cpu":
        use_plain_attention(model)
        keep_freed_memory()
    return model.train()


def textbook_model(case: Case) -> Model:
    """The same weights in PyTorch's default layout, with a `TextbookCascade` and SAM's attention
    as its authors wrote it."""
    model = build_case(case)
    assert isinstance(model, MultiViewSAM)
    if model.cascade is not None:
        model.cascade = TextbookCascade(model.cascade)  # pyright: ignore[reportAttributeAccessIssue]
    use_plain_attention(model)
    return model.train(case.work == "train")


def build_case(case: Case) -> Model:
    """The case's model with its number of planes; the weights do not depend on that.

    In training all of it works at the pictures' size, as in `mvsam train`.
    """
    model = build(case.model)
    if case.work == "train":
        model.input_size = (case.width, case.height)
    if case.num_planes is not None:
        assert isinstance(model, MultiViewSAM) and model.cascade is not None
        model.cascade.num_planes = case.num_planes
    return model


def share_features(model: Model, views: Views, num_references: int) -> list[Prediction]:
    """View 0, 1, ... as reference; a model that can encode apart does so once."""
    if not isinstance(model, MultiViewSAM) or num_references == 1:
        return repeat_all(model, views, num_references)
    features = model.encode(views)
    return [model.decode(features, views, reference) for reference in range(num_references)]


def repeat_all(model: Model, views: Views, num_references: int) -> list[Prediction]:
    """View 0, 1, ... as reference, each in a call of its own that encodes all views anew."""
    return [model(views.with_reference(reference)) for reference in range(num_references)]


FORMS: dict[FormName, Form] = {
    "ours": Form(our_model, share_features),
    "textbook": Form(textbook_model, repeat_all),
}
