"""Weights on the Hugging Face hub: a repository of weights, page and model card."""

import re
from pathlib import Path

from mvsam.errors import InputError
from mvsam.weights.page import HUB_CARD, HUB_PAGE, HUB_WEIGHTS, model_card, read_info

_HUB_ID = re.compile(r"(?P<repository>[\w.-]+/[\w.-]+)(?:@(?P<revision>[\w./-]+))?")


def is_hub_id(name: str) -> bool:
    """Whether it reads `owner/name` or `owner/name@revision`."""
    return _HUB_ID.fullmatch(name) is not None


def download(hub_id: str) -> tuple[Path, Path]:
    """The weights file and its page, from the hub or from what was downloaded before.

    The revision is a branch, a tag or a commit; without one the newest is taken.
    """
    from huggingface_hub import hf_hub_download
    from huggingface_hub.errors import HfHubHTTPError, LocalEntryNotFoundError

    match = _HUB_ID.fullmatch(hub_id)
    assert match is not None
    repository, revision = match["repository"], match["revision"]
    try:
        weights, page = (
            Path(hf_hub_download(repository, name, revision=revision))
            for name in (HUB_WEIGHTS, HUB_PAGE)
        )
    except (HfHubHTTPError, LocalEntryNotFoundError, OSError) as error:
        raise InputError(
            f"{hub_id}: neither a file here nor to be had from the Hugging Face hub "
            f"({type(error).__name__}); download {HUB_WEIGHTS} and {HUB_PAGE} and give the path."
        ) from error
    return weights, page


def push_to_hub(folder: Path, repository: str, private: bool = False) -> str:
    """Uploads a run's weights, their page and a model card in one commit; returns its address.

    The card is the folder's `README.md`; where there is none, one is made from the page. Needs a
    login (`hf auth login`).
    """
    from huggingface_hub import CommitOperationAdd, HfApi

    for name in (HUB_WEIGHTS, HUB_PAGE):
        if not (folder / name).is_file():
            raise InputError(f"{folder / name} is missing: give the folder of a finished run.")
    made = model_card(read_info(folder / HUB_PAGE), repository).encode()
    own = folder / HUB_CARD
    card = own if own.is_file() else made
    operations = [
        CommitOperationAdd(HUB_WEIGHTS, folder / HUB_WEIGHTS),
        CommitOperationAdd(HUB_PAGE, folder / HUB_PAGE),
        CommitOperationAdd(HUB_CARD, card),
    ]
    api = HfApi()
    api.create_repo(repository, private=private, exist_ok=True)
    message = "Weights, page and model card"
    return str(api.create_commit(repository, operations, commit_message=message))
