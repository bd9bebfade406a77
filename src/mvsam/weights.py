"""Weights in and out: safetensors beside a JSON page, the Hugging Face hub, SAM's own files.

No file can run code: `.safetensors` holds numbers only, `.pth` and `.ckpt` are read with
`weights_only=True`.
"""

import hashlib
import json
import os
import pickle
import re
from dataclasses import asdict, dataclass, field
from inspect import signature
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from mvsam.build import MODELS, build, model_spec
from mvsam.errors import InputError
from mvsam.model import MultiViewSAM
from mvsam.segmentation.decoder import SemanticDecoder
from mvsam.types import Model

ASSETS = Path(__file__).parent / "assets"
HUB_WEIGHTS, HUB_PAGE = "model.safetensors", "model.json"
AnyModule = TypeVar("AnyModule", bound=nn.Module)

RUN_PAGE = "experiment.json"
"""What a run writes beside its checkpoints; says enough to load one."""


@dataclass(frozen=True)
class WeightsInfo:
    """What a weights file says of itself: the JSON page beside it."""

    model: str
    """Name in `build.MODELS`."""
    num_classes: int = 20
    classes: tuple[str, ...] = ()
    """Class names in order; empty for ScanNet's 20."""
    palette: tuple[tuple[int, int, int], ...] = ()
    depth_range: tuple[float, float] = (0.1, 5.0)
    """Metres, as trained."""
    input_size: tuple[int, int] = (320, 256)
    """(width, height), pixels."""
    training: dict[str, Any] = field(default_factory=dict)
    """Run, steps, commit."""


def embedded() -> list[str]:
    """Names of the models whose weights come with the package."""
    return sorted(path.stem for path in ASSETS.glob("*.safetensors"))


def load(name: str) -> Model:
    """A model with its weights, in evaluation mode, by embedded name, file path or hub id.

    The model carries `info` (a `WeightsInfo`), `input_size` and `weights_hash`.
    Raises InputError for an unknown name, a file that is missing, corrupt or of another model.
    """
    path, page = locate(name)
    info = read_info(page)
    # Nothing is to be tuned: frozen blocks need no gradient.
    has_option = "tuned_blocks" in signature(model_spec(info.model).build).parameters
    model = build(info.model, info.num_classes, **({"tuned_blocks": 0} if has_option else {}))
    _load_strictly(model, read_tensors(path), path)
    model.info, model.input_size = info, info.input_size
    model.weights_hash = file_hash(path)
    return layout_channels_last(model).eval()


def from_pretrained(name: str) -> Model:
    """`load` under the name Hugging Face users look for."""
    return load(name)


def locate(name: str) -> tuple[Path, Path]:
    """The weights file and its page for a name, a path or a hub id (downloaded)."""
    if (ASSETS / f"{name}.safetensors").exists():
        return ASSETS / f"{name}.safetensors", ASSETS / f"{name}.json"
    path = Path(name)
    if path.is_dir() and (path / HUB_WEIGHTS).exists():
        path = path / HUB_WEIGHTS
    if path.suffix in (".safetensors", ".ckpt", ".pth"):
        if not path.is_file():
            raise InputError(f"{path}: no such weights file.")
        page = path.with_suffix(".json")
        if path.suffix == ".ckpt" and not page.exists():
            page = path.with_name(RUN_PAGE)
        return path, page
    if path.exists():
        raise InputError(f"{path} holds no {HUB_WEIGHTS}: is the run finished?")
    if name in MODELS:
        raise InputError(
            f"model '{name}' has no embedded weights (there are: {', '.join(embedded())}); train "
            f"it with `mvsam train` or give the path of a weights file."
        )
    if re.fullmatch(r"[\w.-]+/[\w.-]+", name):
        return _download(name)
    model_spec(name)  # raises, with the nearest name
    raise AssertionError


def _download(repository: str) -> tuple[Path, Path]:
    from huggingface_hub import hf_hub_download
    from huggingface_hub.errors import HfHubHTTPError, LocalEntryNotFoundError

    try:
        return tuple(Path(hf_hub_download(repository, f)) for f in (HUB_WEIGHTS, HUB_PAGE))  # pyright: ignore[reportReturnType]
    except (HfHubHTTPError, LocalEntryNotFoundError, OSError) as error:
        raise InputError(
            f"{repository}: neither a file here nor to be had from the Hugging Face hub "
            f"({type(error).__name__}); download {HUB_WEIGHTS} and {HUB_PAGE} and give the path."
        ) from error


def push_to_hub(folder: Path, repository: str, private: bool = False) -> str:
    """Uploads `model.safetensors` and `model.json` of a run's folder; returns the page's address.

    Needs a login (`hf auth login`).
    """
    from huggingface_hub import HfApi

    for name in (HUB_WEIGHTS, HUB_PAGE):
        if not (folder / name).is_file():
            raise InputError(f"{folder / name} is missing: give the folder of a finished run.")
    api = HfApi()
    api.create_repo(repository, private=private, exist_ok=True)
    return str(
        api.upload_folder(
            repo_id=repository, folder_path=folder, allow_patterns=[HUB_WEIGHTS, HUB_PAGE]
        )
    )


def save(
    model: nn.Module,
    path: str | Path,
    name: str,
    depth_range: tuple[float, float] = (0.1, 5.0),
    training: dict[str, Any] | None = None,
    half: bool = False,
    classes: tuple[str, ...] = (),
    palette: tuple[tuple[int, int, int], ...] = (),
) -> None:
    """Writes `path` (.safetensors) and its page; `half` keeps float16, exact to 0.05 %."""
    tensors = {
        key: (value.half() if half and value.is_floating_point() else value).contiguous().cpu()
        for key, value in model.state_dict().items()
    }
    info = WeightsInfo(
        model=name,
        num_classes=getattr(model, "num_classes", 20),
        classes=classes,
        palette=palette,
        depth_range=depth_range,
        input_size=model_spec(name).input_size,
        training=training or {},
    )
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    save_file(tensors, temporary)
    temporary.chmod(0o644)  # safetensors writes for the owner alone
    temporary.replace(path)
    path.with_suffix(".json").write_text(json.dumps(asdict(info), indent=2) + "\n")


def read_info(page: Path) -> WeightsInfo:
    """The JSON page of a weights file; InputError if it is missing or not one."""
    try:
        content = json.loads(page.read_text())
        if page.name == RUN_PAGE:
            content = _info_of_run(content)
        content = {key: _as_tuples(value) for key, value in content.items()}
        info = WeightsInfo(**content)
    except FileNotFoundError as error:
        raise InputError(f"{page} is missing: it belongs beside the weights.") from error
    except (ValueError, TypeError, AttributeError, KeyError) as error:
        raise InputError(f"{page} is not a page of mvsam weights ({error}).") from error
    model_spec(info.model)
    return info


def _info_of_run(experiment: dict[str, Any]) -> dict[str, Any]:
    """The page of a checkpoint, from the experiment it belongs to."""
    model = experiment["model"]
    return {
        "model": model["name"],
        "num_classes": model["num_classes"],
        "classes": experiment.get("classes", ()),
        "palette": experiment.get("palette", ()),
        "depth_range": experiment["data"]["depth_range"],
        "input_size": model_spec(model["name"]).input_size,
        "training": {"run": experiment["name"], "commit": experiment["commit"]},
    }


def _as_tuples(value: Any) -> Any:
    return tuple(_as_tuples(item) for item in value) if isinstance(value, list) else value


def read_tensors(path: Path) -> dict[str, Tensor]:
    """Named float32 tensors of a weights file; InputError if it is corrupt or could run code."""
    try:
        if path.suffix == ".safetensors":
            tensors = load_file(path)
        else:
            tensors = _model_entries(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as error:  # a broken pickle can end in any exception there is
        raise InputError(
            f"{path}: not a readable weights file (truncated, corrupt, or it holds more than "
            f"numbers): {type(error).__name__}."
        ) from error
    return {k: v.float() if v.is_floating_point() else v for k, v in tensors.items()}


def _model_entries(checkpoint: Any) -> dict[str, Tensor]:
    """The tensors of a plain state dict, or those of the model in a Lightning checkpoint."""
    if isinstance(checkpoint, dict) and "state_dict" in checkpoint:
        entries = checkpoint["state_dict"]
        return {k.removeprefix("model."): v for k, v in entries.items() if k.startswith("model.")}
    if isinstance(checkpoint, dict) and all(isinstance(v, Tensor) for v in checkpoint.values()):
        return checkpoint
    raise pickle.UnpicklingError("no tensors by name")


def load_into(model: nn.Module, name: str) -> list[str]:
    """Starts `model` from other weights; returns the entries that find none of their shape."""
    path, _ = locate(name)
    given, own = read_tensors(path), model.state_dict()
    fitting = {k: v for k, v in given.items() if k in own and v.shape == own[k].shape}
    if not fitting:
        raise InputError(f"{path}: none of its weights fits this model.")
    model.load_state_dict(fitting, strict=False)
    return sorted(set(own) - set(fitting))


_SAM_DECODER_NAMES = (
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
    _load_strictly(encoder.backbone, released, path)
    matrix = tensors.get("prompt_encoder.pe_layer.positional_encoding_gaussian_matrix")
    position = getattr(model.decoder, "position", None)
    if position is not None:
        if matrix is None or matrix.shape != position.gaussian.shape:
            raise InputError(f"{path}: SAM's positional matrix is missing or of another size.")
        position.gaussian.copy_(matrix)
    if include_decoder:
        _load_sam_decoder(model, tensors, path)


def _load_sam_decoder(model: MultiViewSAM, tensors: dict[str, Tensor], path: Path) -> None:
    decoder = model.decoder
    if not isinstance(decoder, SemanticDecoder):
        raise InputError("this model has no transformer decoder to load SAM's into.")
    for part in ("transformer", "upscaling"):
        renamed = {}
        for key, value in tensors.items():
            name = key.removeprefix("mask_decoder.")
            for theirs, ours in _SAM_DECODER_NAMES:
                name = name.replace(theirs, ours)
            if key.startswith("mask_decoder.") and name.startswith(f"{part}."):
                renamed[name.removeprefix(f"{part}.")] = value
        _load_strictly(getattr(decoder, part), renamed, path)


def _load_strictly(module: nn.Module, tensors: dict[str, Tensor], path: Path) -> None:
    own = module.state_dict()
    missing, unknown = sorted(set(own) - set(tensors)), sorted(set(tensors) - set(own))
    misshapen = sorted(k for k in set(own) & set(tensors) if own[k].shape != tensors[k].shape)
    problems = {"missing": missing, "unknown": unknown, "of another shape": misshapen}
    said = [f"{len(v)} {k} (first: {v[0]})" for k, v in problems.items() if v]
    if said:
        raise InputError(f"{path} does not fit this model: {'; '.join(said)}.")
    module.load_state_dict(tensors)


def file_hash(path: Path) -> str:
    """First 16 digits of the file's SHA-256."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def layout_channels_last(model: AnyModule) -> AnyModule:
    """The same model, convolution weights in channels-last order: faster on CPUs and GPUs."""
    for module in model.modules():
        if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
            module.to(memory_format=torch.channels_last)
        elif isinstance(module, nn.Conv3d | nn.ConvTranspose3d):
            module.to(memory_format=torch.channels_last_3d)
    return model
