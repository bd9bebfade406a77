"""The JSON page beside a weights file, and the model card made from it."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mvsam.build import count_parameters, model_spec
from mvsam.errors import InputError

HUB_WEIGHTS, HUB_PAGE, HUB_CARD = "model.safetensors", "model.json", "README.md"
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
    """(width, height) of the pictures it was trained on, pixels."""
    semantic_size: tuple[int, int] | None = None
    """(width, height) of the photos for the semantic encoder; none: it sees those of input_size."""
    training: dict[str, Any] = field(default_factory=dict)
    """Run, steps, commit."""


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
        "input_size": experiment["data"]["size"],
        "semantic_size": experiment["data"].get("semantic_size"),
        "training": {"run": experiment["name"], "commit": experiment["commit"]},
    }


def _as_tuples(value: Any) -> Any:
    return tuple(_as_tuples(item) for item in value) if isinstance(value, list) else value


def model_card(info: WeightsInfo, repository: str) -> str:
    """Markdown for the hub: what the page says, and how to load the weights from there.

    It names no licence, because that is the choice of whoever trained the weights.
    """
    spec = model_spec(info.model)
    width, height = info.input_size
    near, far = info.depth_range
    classes = ", ".join(info.classes) or "ScanNet's 20"
    training = ", ".join(f"{key} {value}" for key, value in info.training.items()) or "not recorded"
    tags = "\n".join(f"- {tag}" for tag in ("multi-view-stereo", *spec.tasks))
    return f"""---
library_name: mvsam
pipeline_tag: depth-estimation
tags:
{tags}
---
# {repository}

`{info.model}` of mvsam, {count_parameters(info.model):,} parameters with 20 classes.

- Input: {spec.inputs}, resized to {width}x{height}
- Output: {" and ".join(spec.tasks)}
- Depth range: {near:g} to {far:g} m
- Classes ({info.num_classes}): {classes}
- Training: {training}

    import mvsam
    model = mvsam.load("{repository}")
"""
