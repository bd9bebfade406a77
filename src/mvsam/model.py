"""Figure 3 in one forward pass: encoders, fusion, cascade, prompt, decoder."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from mvsam.encoders.fpn import FeaturePyramid
from mvsam.encoders.fusion import SemanticPyramid
from mvsam.encoders.sam import SamEncoder
from mvsam.encoders.unet import UNetPyramid
from mvsam.mvs.cascade import DepthCascade, Weighing, combined_confidence
from mvsam.mvs.context import ContextNetwork
from mvsam.mvs.prior import MonocularPrior, log_density
from mvsam.segmentation.decoder import ConvDecoder, SemanticDecoder
from mvsam.segmentation.prompts import DepthPrompt
from mvsam.types import DepthPrior, DepthStage, Model, Prediction, Views


@dataclass(frozen=True)
class Features:
    """What the encoders say about each view; independent of which one becomes the reference."""

    pyramid: tuple[Float[Tensor, "batch view _channel _height _width"], ...] = ()
    """Coarse to fine, semantics already added; empty where the model has no cascade."""
    semantic: Float[Tensor, "batch view channel h4 w4"] | None = None
    """SAM features at a quarter of the image, with `has_finer_sweeps` of `input_size` at most; None
    where the model has no SAM encoder."""

    def select(self, order: list[int]) -> "Features":
        """The features of these views, in this order."""
        return Features(
            tuple(level[:, order] for level in self.pyramid),
            None if self.semantic is None else self.semantic[:, order],
        )

    @staticmethod
    def join(parts: "list[Features]") -> "Features":
        """Views encoded apart, side by side again."""
        semantic = [part.semantic for part in parts if part.semantic is not None]
        return Features(
            tuple(
                torch.cat(levels, dim=1) for levels in zip(*(p.pyramid for p in parts), strict=True)
            ),
            torch.cat(semantic, dim=1) if semantic else None,
        )


PARTS_NEEDED = {
    "geometry_encoder": ("cascade",),
    "bridge": ("geometry_encoder", "semantic_encoder"),
    "cascade": ("geometry_encoder",),
    "prior": ("semantic_encoder",),
    "context": ("cascade", "prior"),
    "prompt": ("decoder",),
    "decoder": ("semantic_encoder",),
}
"""What each part works with; without it a part would be passed over in silence."""


class MultiViewSAM(Model):
    """The network of "Joint Depth Prediction and Semantic Segmentation with Multi-View SAM".

    It is put together from built parts (`assemblies/`); a part that an ablation lacks is None.
    Raises ValueError for a part whose counterpart in `PARTS_NEEDED` is missing.
    prior, context: not the paper's; see `mvs/prior.py` and `mvs/context.py`.
    prompt_passes_gradient: whether the segmentation loss reaches the depth through the prompt. The
    paper trains "end-to-end" and does not detach; between the cascade's stages depth is detached.
    has_finer_sweeps: whether pictures larger than `input_size`, with which the model learned, serve
    the later sweeps alone, and all else sees them at `input_size`. Not the paper's (docs/paper.md).
    Image sides must be divisible by 32 where there is a cascade, by 4 otherwise.
    """

    def __init__(
        self,
        geometry_encoder: FeaturePyramid | UNetPyramid | None = None,
        semantic_encoder: SamEncoder | None = None,
        bridge: SemanticPyramid | None = None,
        cascade: DepthCascade | None = None,
        prior: MonocularPrior | None = None,
        context: ContextNetwork | None = None,
        prompt: DepthPrompt | None = None,
        decoder: SemanticDecoder | ConvDecoder | None = None,
        prompt_passes_gradient: bool = True,
        has_finer_sweeps: bool = False,
    ):
        super().__init__()
        self.geometry_encoder = geometry_encoder
        self.semantic_encoder = semantic_encoder
        self.bridge = bridge
        self.cascade = cascade
        self.prior = prior
        self.context = context
        self.prompt = prompt
        self.decoder = decoder
        self.prompt_passes_gradient = prompt_passes_gradient
        self.has_finer_sweeps = has_finer_sweeps
        self.reads_depth = prompt is not None and cascade is None
        for part, needed in PARTS_NEEDED.items():
            if getattr(self, part) is not None and any(getattr(self, n) is None for n in needed):
                raise ValueError(f"the {part} needs {' and '.join(needed)}")
        if prompt is not None and isinstance(decoder, ConvDecoder):
            raise ValueError("a ConvDecoder takes no prompt; leave the prompt out")
        if decoder is not None:
            self.num_classes = decoder.num_classes

    def forward(self, views: Views) -> Prediction:
        """Depth, confidence and logits of view 0."""
        seen = views if self.cascade else views.select([0])
        return self.decode(self.encode(seen), views)

    def encode(self, views: Views) -> Features:
        """Steps (1) to (3) for every view: SAM features, geometric pyramid, their sum (Sec. 3.1).

        A model without a cascade looks at view 0 alone when called, but at every view given here.
        With `has_finer_sweeps` the coarsest level of larger pictures comes from reduced ones.
        Raises ValueError for image sides that do not divide, or without the `semantic_images` that
        the model was trained with.
        """
        self._check(views)
        images = views.images.flatten(0, 1)
        size = self._learned_size(views)
        semantic = self._semantic_features(views)
        pyramid = self._pyramid(_resized(images, size), semantic)
        if size != (views.height, views.width):
            pyramid = (*pyramid[:1], *self._pyramid(images, semantic)[1:])

        def per_view(x: Tensor) -> Tensor:
            return x.unflatten(0, views.images.shape[:2])

        return Features(
            tuple(per_view(level) for level in pyramid),
            None if semantic is None else per_view(semantic),
        )

    def decode(self, features: Features, views: Views, reference: int = 0) -> Prediction:
        """Steps (4) to (6) for one view as reference: cascade, prompt, decoder (Sec. 3.2, 3.3).

        Where there is a prior it weighs the cascade's first hypotheses, and the context network,
        where there is one, has the last word on them; without a cascade the prior is only
        predicted, so that the loss can train it.

        Raises ValueError for a reference that is no view, for another than 0 where the model reads
        measured depth, which belongs to view 0, and for a single view where there is a cascade.
        """
        if self.cascade and views.images.shape[1] < 2:  # a symbol, no int, while it is exported
            raise ValueError("one view: a plane sweep needs a source beside the reference")
        if reference:
            order = views.reference_first(reference)
            features, views = features.select(order), views.with_reference(reference)
        prior = self._prior(features, views)
        weigh = None if prior is None else self._weighing(features, views, prior)
        stages = self.cascade(features.pyramid, views, weigh) if self.cascade else []
        depth = stages[-1].depth if stages else None
        confidence = self._confidence(stages, views) if stages else None
        logits = self._segment(features, views, depth) if self.decoder else None
        return Prediction(depth, confidence, logits, stages, prior)

    def segment(self, views: Views) -> Prediction:
        """Logits (and prior) of view 0 alone, prompted with measured depth: no Sec. 3.2.

        For labelled photographs that have no neighbours with poses. Raises ValueError where the
        model has no decoder, or a prompt and no measured depth for it.
        """
        if self.decoder is None:
            raise ValueError("this model has no decoder, so it cannot label pictures")
        self._check(views)
        alone = views.select([0])
        semantic = self._semantic_features(alone)
        assert semantic is not None
        features = Features(semantic=semantic.unflatten(0, alone.images.shape[:2]))
        logits, prior = self._segment(features, alone, None), self._prior(features, alone)
        return Prediction(logits=logits, prior=prior)

    def _prior(self, features: Features, views: Views) -> DepthPrior | None:
        if self.prior is None:
            return None
        assert features.semantic is not None
        return self.prior(features.semantic[:, 0], views)

    def _weighing(self, features: Features, views: Views, prior: DepthPrior) -> Weighing:
        """What the scores of the first sweep of view 0 go through."""

        def weigh(scores: Tensor, hypotheses: Tensor) -> Tensor:
            scores = scores + log_density(prior, hypotheses)
            if self.context is None:
                return scores
            assert features.semantic is not None
            seen = (features.pyramid[0][:, 0], features.semantic[:, 0])
            return self.context(scores, hypotheses, *seen, prior, views)

        return weigh

    def _learned_size(self, views: Views) -> tuple[int, int]:
        """(height, width) at which all but the later sweeps see these pictures."""
        width, height = self.input_size
        is_smaller = views.width < width or views.height < height
        if is_smaller or not self.has_finer_sweeps:
            return views.height, views.width
        return height, width

    def _pyramid(
        self, images: Float[Tensor, "image 3 height width"], semantic: Tensor | None
    ) -> tuple[Tensor, ...]:
        """Steps (2) and (3): coarse to fine, at the pictures' size."""
        if self.geometry_encoder is None:
            return ()
        pyramid = self.geometry_encoder(images)
        if self.bridge is None or semantic is None:
            return pyramid
        added = self.bridge(_resized(semantic, pyramid[0].shape[-2:]))
        return tuple(a + b for a, b in zip(pyramid, added, strict=True))

    def _semantic_features(self, views: Views) -> Float[Tensor, "batch_view channel h4 w4"] | None:
        if self.semantic_encoder is None:
            return None
        height, width = self._learned_size(views)
        given = views.semantic_images
        if given is None:
            pictures = _resized(views.images.flatten(0, 1), (height, width))
        else:
            pictures = given.flatten(0, 1)
        return self.semantic_encoder(pictures, (height // 4, width // 4))

    def _confidence(self, stages: list[DepthStage], views: Views) -> Tensor:
        confidence = combined_confidence(stages, self._learned_size(views))
        return _resized(confidence[:, None], (views.height, views.width))[:, 0]

    def _check(self, views: Views) -> None:
        divisor = 32 if self.cascade else 4
        if views.height % divisor or views.width % divisor:
            raise ValueError(
                f"images of {views.width}x{views.height}: both sides must be divisible by "
                f"{divisor}; resize them together with their intrinsics"
            )
        if self.semantic_size is not None and views.semantic_images is None:
            raise ValueError(
                "this model was trained with photos for SAM: set views.semantic_images, as "
                "make_views(frames, semantic_size=model.semantic_size) does"
            )

    def _segment(self, features: Features, views: Views, depth: Tensor | None) -> Tensor:
        assert self.decoder is not None and features.semantic is not None
        semantic = features.semantic[:, 0]
        prompt = None
        if self.prompt is not None:
            depth = views.measured_depth if depth is None else depth
            if depth is None:
                raise ValueError(
                    "this model is prompted with measured depth: set views.measured_depth"
                )
            if not self.prompt_passes_gradient:
                depth = depth.detach()
            height, width = semantic.shape[-2:]
            prompt = self.prompt(_reduced_depth(depth, (4 * height, 4 * width)), views.depth_range)
        logits = self.decoder(semantic, prompt).float()
        return _resized(logits, (views.height, views.width))


def _resized(maps: Float[Tensor, "map channel _h _w"], size: tuple[int, int]) -> Tensor:
    """Bilinear at (height, width); where it shrinks, over all of each new pixel."""
    if maps.shape[-2:] == size:
        return maps
    shrinks = maps.shape[-2] > size[0] or maps.shape[-1] > size[1]
    return F.interpolate(maps, size, mode="bilinear", align_corners=False, antialias=shrinks)


def _reduced_depth(depth: Float[Tensor, "batch _h _w"], size: tuple[int, int]) -> Tensor:
    """Nearest pixels at (height, width): no depth between two surfaces."""
    if depth.shape[-2:] == size:
        return depth
    return F.interpolate(depth[:, None], size, mode="nearest-exact")[:, 0]
