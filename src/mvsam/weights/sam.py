"""SAM's released checkpoints: its names become ours."""

from pathlib import Path

from torch import Tensor

from mvsam.errors import InputError
from mvsam.model import MultiViewSAM
from mvsam.segmentation.decoder import SemanticDecoder
from mvsam.types import Model
from mvsam.weights.tensors import load_strictly, read_tensors

_DECODER_NAMES = (
    ("transformer.final_attn_token_to_image.", "transformer.tokens_to_image."),
    ("transformer.norm_final_attn.", "transformer.norm."),
    ("transformer.layers.", "transformer.blocks."),
    ("cross_attn_token_to_image.", "tokens_to_image."),
    ("cross_attn_image_to_token.", "image_to_tokens."),
    ("self_attn.", "self_attention."),
    ("q_proj.", "query."),
    ("k_proj.", "key."),
    ("v_proj.", "value."),
    ("out_proj.", "out."),
    ("mlp.lin1.", "mlp.0."),
    ("mlp.lin2.", "mlp.2."),
    ("output_upscaling.", "upscaling."),
)
"""SAM's names in its mask decoder and ours, applied in this order."""


def load_sam(model: Model, path: str | Path, include_decoder: bool = False) -> None:
    """Loads SAM's released `sam_vit_b_*.pth`: every image encoder key, and the position matrix.

    include_decoder: also SAM's two-way transformer and upscaling; the paper calls only the encoder
    pre-trained, so by default the decoder stays random. Other keys are ignored by name; a missing,
    unknown or misshapen `image_encoder.*` key is an InputError.
    """
    path = Path(path)
    encoder = model.semantic_encoder if isinstance(model, MultiViewSAM) else None
    if not isinstance(model, MultiViewSAM) or encoder is None:
        raise InputError("this model has no SAM encoder to load weights into.")
    if not path.is_file():
        raise InputError(
            f"{path} is missing: fetch sam_vit_b_01ec64.pth from the segment-anything project's "
            "page and give its path."
        )
    tensors = read_tensors(path)
    prefix = "image_encoder."
    released = {
        k.removeprefix(prefix).replace("mlp.lin", "mlp.fc"): v
        for k, v in tensors.items()
        if k.startswith(prefix)
    }
    load_strictly(encoder.backbone, released, path)
    matrix = tensors.get("prompt_encoder.pe_layer.positional_encoding_gaussian_matrix")
    position = getattr(model.decoder, "position", None)
    if position is not None:
        if matrix is None or matrix.shape != position.gaussian.shape:
            raise InputError(f"{path}: SAM's positional matrix is missing or of another size.")
        position.gaussian.copy_(matrix)
    if include_decoder:
        _load_decoder(model, tensors, path)


def _load_decoder(model: MultiViewSAM, tensors: dict[str, Tensor], path: Path) -> None:
    decoder = model.decoder
    if not isinstance(decoder, SemanticDecoder):
        raise InputError("this model has no transformer decoder to load SAM's into.")
    for part in ("transformer", "upscaling"):
        renamed = {}
        for key, value in tensors.items():
            name = key.removeprefix("mask_decoder.")
            for theirs, ours in _DECODER_NAMES:
                name = name.replace(theirs, ours)
            if key.startswith("mask_decoder.") and name.startswith(f"{part}."):
                renamed[name.removeprefix(f"{part}.")] = value
        load_strictly(getattr(decoder, part), renamed, path)
