"""The hub's client is replaced: nothing here needs a network."""

from pathlib import Path

import huggingface_hub
import pytest
from huggingface_hub.errors import LocalEntryNotFoundError

from mvsam import weights
from mvsam.errors import InputError
from mvsam.weights import save
from tests.weights.conftest import trained


@pytest.mark.parametrize(
    "hub_id, revision",
    [
        ("someone/rooms-cas", None),
        ("someone/rooms-cas@v1.0", "v1.0"),
        ("someone/rooms-cas@refs/pr/3", "refs/pr/3"),
    ],
)
def test_a_hub_id_is_downloaded_in_the_revision_it_names(
    hub_id: str, revision: str | None, tmp_path: Path, monkeypatch
):
    save(trained(), tmp_path / weights.HUB_WEIGHTS, "cas_mvsnet")
    asked = []

    def download(repository: str, name: str, revision: str | None) -> str:
        asked.append((repository, name, revision))
        return str(tmp_path / name)

    monkeypatch.setattr(huggingface_hub, "hf_hub_download", download)
    assert weights.load(hub_id).info.model == "cas_mvsnet"
    names = (weights.HUB_WEIGHTS, weights.HUB_PAGE)
    assert asked == [("someone/rooms-cas", name, revision) for name in names]


def test_an_unreachable_hub_says_which_files_to_fetch(monkeypatch):
    def download(*_, **__) -> str:
        raise LocalEntryNotFoundError("offline")

    monkeypatch.setattr(huggingface_hub, "hf_hub_download", download)
    with pytest.raises(InputError, match=r"someone/model@v2: .*download model\.safetensors and"):
        weights.load("someone/model@v2")


def test_pushing_an_unfinished_run_names_what_is_missing(tmp_path: Path):
    with pytest.raises(InputError, match=r"model\.safetensors is missing"):
        weights.push_to_hub(tmp_path, "someone/model")


@pytest.fixture
def pushed(monkeypatch) -> dict:
    """What the hub received, by name."""
    received: dict = {}

    class Api:
        def create_repo(self, repository: str, private: bool, exist_ok: bool) -> None:
            received["repository"] = repository, private, exist_ok

        def create_commit(self, repository: str, operations: list, commit_message: str) -> str:
            assert repository == received["repository"][0] and commit_message
            received.update({each.path_in_repo: each.path_or_fileobj for each in operations})
            return "address of the commit"

    monkeypatch.setattr(huggingface_hub, "HfApi", Api)
    return received


def test_pushing_uploads_weights_page_and_a_card_made_from_it(tmp_path: Path, pushed: dict):
    training = {"run": "mine", "steps": 12}
    save(trained(), tmp_path / weights.HUB_WEIGHTS, "cas_mvsnet", training=training)
    (tmp_path / "last.ckpt").write_text("stays here")
    address = weights.push_to_hub(tmp_path, "someone/model", private=True)
    assert address == "address of the commit"
    assert pushed.pop("repository") == ("someone/model", True, True)
    card = pushed.pop("README.md").decode()
    assert {name: Path(path) for name, path in pushed.items()} == {
        name: tmp_path / name for name in (weights.HUB_WEIGHTS, weights.HUB_PAGE)
    }
    assert card.startswith("---\nlibrary_name: mvsam\n")
    assert 'mvsam.load("someone/model")' in card
    assert "934,304 parameters" in card and "run mine, steps 12" in card and "0.1 to 5 m" in card


def test_the_card_of_the_run_s_own_folder_is_taken_where_there_is_one(tmp_path: Path, pushed: dict):
    save(trained(), tmp_path / weights.HUB_WEIGHTS, "cas_mvsnet")
    (tmp_path / "README.md").write_text("# Mine")
    weights.push_to_hub(tmp_path, "someone/model")
    assert Path(pushed["README.md"]) == tmp_path / "README.md"
