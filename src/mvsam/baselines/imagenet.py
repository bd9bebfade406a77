"""ImageNet networks as beginnings: how their input is normalised, where their weights come from."""

from collections.abc import Callable, Mapping
from pathlib import Path

from jaxtyping import Float
from timm.models import load_state_dict
from torch import Tensor, nn

from mvsam.encoders.unet import normalize
from mvsam.errors import InputError
from mvsam.types import Views

DOWNLOAD = "download"
"""Instead of a file: fetch the weights from where they were released."""


def reference_image(views: Views, divisor: int = 1) -> Float[Tensor, "batch 3 height width"]:
    """View 0 with ImageNet's mean and deviation (SAM uses the same).

    Raises ValueError where a side is not divisible by `divisor`, which the network needs.
    """
    if views.height % divisor or views.width % divisor:
        raise ValueError(
            f"image sides must be divisible by {divisor}, not {views.width} x {views.height}"
        )
    return normalize(views.images[:, 0])


def load_imagenet(
    backbone: nn.Module,
    source: str | None,
    released: Callable[[], Mapping[str, Tensor]],
    prefix: str = "",
) -> str:
    """Starts `backbone` from ImageNet weights and returns what `Model.backbone_weights` says.

    source: None leaves it as it is; `DOWNLOAD` asks `released`; else a local file of the same
    weights (.pth or .safetensors). `prefix` comes before the backbone's names there. Other
    entries (a classifier) are ignored; InputError if one of the backbone's is missing or misshapen,
    or if there is nothing to read.
    """
    if source is None:
        return "random"
    given = _read(source, released)
    own = {k: v for k, v in backbone.state_dict().items() if "num_batches_tracked" not in k}
    fitting = {k: given[prefix + k] for k in own if prefix + k in given}
    wrong = [k for k, v in own.items() if k not in fitting or fitting[k].shape != v.shape]
    if wrong:
        raise InputError(
            f"{source} holds other weights than this backbone's: {len(wrong)} of {len(own)} "
            f"entries are missing or of another shape (first: {prefix}{wrong[0]})."
        )
    backbone.load_state_dict(fitting, strict=False)
    return "imagenet" if source == DOWNLOAD else Path(source).name


def _read(source: str, released: Callable[[], Mapping[str, Tensor]]) -> Mapping[str, Tensor]:
    try:
        return released() if source == DOWNLOAD else load_state_dict(source)
    except OSError as error:  # no network, no such file
        raise InputError(
            f"ImageNet weights: '{source}' is not to be had ({type(error).__name__}); give the "
            "path of a downloaded file, or none to begin from random weights."
        ) from error
    except Exception as error:  # a broken pickle can end in any exception there is
        raise InputError(
            f"{source}: not a readable weights file ({type(error).__name__})."
        ) from error
