"""Models with their weights, from and to files; names become paths."""

from dataclasses import asdict
from difflib import get_close_matches
from inspect import signature
from pathlib import Path
from typing import Any

import safetensors.torch
from torch import Tensor, nn

from mvsam.build import MODELS, build, model_spec
from mvsam.errors import InputError
from mvsam.files import write_json, write_whole
from mvsam.types import Model
from mvsam.weights.hub import download, is_hub_id
from mvsam.weights.page import HUB_WEIGHTS, RUN_PAGE, WeightsInfo, read_info
from mvsam.weights.tensors import file_hash, layout_channels_last, load_strictly, read_tensors

ASSETS = Path(__file__).parents[1] / "assets"


def embedded() -> list[str]:
    """Names of the models whose weights come with the package."""
    return sorted(path.stem for path in ASSETS.glob("*.safetensors") if _has_page(path))


def _has_page(path: Path) -> bool:
    """A part of a model, as the rows' encoder, has none."""
    return path.with_suffix(".json").exists()


def load(name: str | Path) -> Model:
    """A model with its weights, in evaluation mode, by embedded name, file path or hub id.

    A hub id is `owner/name` or `owner/name@revision`, a branch, tag or commit.
    The model carries `info` (a `WeightsInfo`), `input_size`, `semantic_size`, `weights_hash`.
    Raises InputError for an unknown name, a file that is missing, corrupt or of another model.
    """
    path, page = locate(name)
    info = read_info(page)
    # Nothing is to be tuned: frozen blocks need no gradient.
    option = signature(model_spec(info.model).build).parameters.get("tuned_blocks")
    has_frozen = option is not None and option.default is not None
    model = build(info.model, info.num_classes, **({"tuned_blocks": 0} if has_frozen else {}))
    load_strictly(model, read_tensors(path), path)
    model.info, model.input_size, model.semantic_size = info, info.input_size, info.semantic_size
    model.weights_hash = file_hash(path)
    return layout_channels_last(model).eval()


def from_pretrained(name: str) -> Model:
    """`load` under the name Hugging Face users look for."""
    return load(name)


def locate(name: str | Path) -> tuple[Path, Path]:
    """The weights file and its page for a name, a path or a hub id (downloaded)."""
    name = str(name)
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
    if is_hub_id(name):
        return download(name)
    close = get_close_matches(name, [*embedded(), *MODELS], n=1)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    raise InputError(
        f"unknown model '{name}'.{hint} With weights: {', '.join(embedded())}; or give the "
        "path of a weights file (mvsam models lists the networks)."
    )


def save(
    model: Model,
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
        num_classes=model.num_classes,
        classes=classes,
        palette=palette,
        depth_range=depth_range,
        input_size=model.input_size,
        semantic_size=model.semantic_size,
        training=training or {},
    )
    path = Path(path)
    content = safetensors.torch.save(tensors)
    write_whole(path, lambda file: file.write(content))
    write_json(path.with_suffix(".json"), asdict(info))


def load_encoder(model: Model, name: str) -> None:
    """Starts the semantic encoder of `model` from that of other weights, and nothing else of it.

    InputError where either has none, or theirs is of another size.
    """
    encoder, (path, _) = getattr(model, "semantic_encoder", None), locate(name)
    if encoder is None:
        raise InputError(f"this model has no semantic encoder to begin with {path}.")
    prefix = "semantic_encoder."
    given = read_tensors(path)
    inside = {k.removeprefix(prefix): v for k, v in given.items() if k.startswith(prefix)}
    load_strictly(encoder, inside, path)


def load_into(model: nn.Module, name: str) -> list[str]:
    """Starts `model` from other weights; returns the entries that find none of their shape.

    Where none fits by its name, they go into the part of the model that takes most of them: those
    of `unet_r34` into the U-Net of `mvs_unet`, say.
    """
    path, _ = locate(name)
    given, own = read_tensors(path), model.state_dict()

    def fitting_in(part: str) -> dict[str, Tensor]:
        inside = {f"{part}{key}": value for key, value in given.items()}
        return {k: v for k, v in inside.items() if k in own and v.shape == own[k].shape}

    fitting = fitting_in("")
    if not fitting:
        parts = [f"{part}." for part, _ in model.named_modules() if part]
        fitting = max((fitting_in(part) for part in parts), key=len, default={})
    if not fitting:
        raise InputError(f"{path}: none of its weights fits this model.")
    model.load_state_dict(fitting, strict=False)
    return sorted(set(own) - set(fitting))
