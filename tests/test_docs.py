"""The documentation is true: links lead somewhere, commands and options exist, examples run."""

import ast
import re
import runpy
import shlex
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mvsam
from mvsam import weights
from mvsam.apps.tables.contents import lines_of
from mvsam.apps.tables.render import measured_text
from mvsam.build import build
from mvsam.cli import main
from mvsam.experiments.runs import RUNS
from mvsam.experiments.tables import TABLES
from tests.synthetic import write_posed_folder

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "mvsam"
SAMPLE = SOURCE / "assets" / "sample"
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
PAGES += sorted((ROOT / "docs").glob("*.md"))
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
PAGE = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)


@pytest.fixture(scope="module")
def random_weights(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "tiny.safetensors"
    mvsam.save(build("tiny"), path, name="tiny")
    return path


def anchors(page: Path) -> set[str]:
    """Where links may lead to in a page: its headings as GitHub spells them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@PAGE
def test_every_relative_link_leads_to_a_file(page: Path):
    for target in LINK.findall(page.read_text()):
        if target.startswith("http"):
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        assert file.exists(), f"{page.name}: {target}"
        if anchor:
            assert anchor in anchors(file), f"{page.name}: {target}"


def named_code(text: str) -> list[tuple[str, list[str]]]:
    """(linked Python file, the names behind it, up to the next link or the end of the cell)."""
    found = []
    for match in re.finditer(r"\]\(([^)]+\.py)\)([^|\[\n]*)", text):
        names = " ".join(re.findall(r"`([^`]+)`", match[2]))
        found.append((match[1], re.findall(r"[A-Za-z_]\w*", names)))
    return found


@PAGE
def test_every_name_behind_a_link_to_code_occurs_in_that_file(page: Path):
    for target, names in named_code(page.read_text()):
        code = (page.parent / target).read_text()
        for name in names:
            assert re.search(rf"\b{name}\b", code), f"{page.name}: {name} is not in {target}"


def test_the_page_of_the_paper_names_much_code():
    names = [
        name for _, names in named_code((ROOT / "docs/paper.md").read_text()) for name in names
    ]
    assert len(names) > 90


def test_the_page_of_the_paper_has_every_equation_section_figure_table_and_open_point():
    text = (ROOT / "docs/paper.md").read_text()
    rows = [line.split("|")[1:-1] for line in text.splitlines() if line.startswith("| ")]
    firsts = [cells[0].strip() for cells in rows]
    for item in ("Eq. 1", "Eq. 2", "Eq. 3", "Eq. 4", "Sec. 3.1", "Sec. 3.2", "Sec. 3.3"):
        assert any(first.startswith(item) for first in firsts), item
    for figure in range(1, 5):
        assert f"Figure {figure}" in text
    tables = {n for first in firsts if re.fullmatch(r"[\d, ]+", first) for n in first.split(", ")}
    assert set("123456") <= tables
    assert [first for first in firsts if first.isdigit()][-32:] == [str(n) for n in range(1, 33)]


def commands(text: str) -> list[list[str]]:
    """Every `mvsam VERB ...` of a page, in blocks and in the text, as words."""
    inline = re.findall(r"`(mvsam [a-z][^`]*)`", text)
    blocks = re.findall(r"^```(?:sh|bash)?\n(.*?)^```", text, re.M | re.S)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    typed = [line.partition("#")[0] for line in lines if line.startswith("mvsam ")]
    return [shlex.split(command)[1:] for command in [*inline, *typed]]


@cache
def options(*words: str) -> str:
    """The help text of a verb, with the settings of a run for `train RUN`."""
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()) as text:
        assert main([*words, "--help"]) == 0, f"mvsam {' '.join(words)} is no command"
    return text.getvalue()


@PAGE
def test_every_command_and_option_of_the_documentation_exists(page: Path):
    for words in commands(page.read_text()):
        verb, *rest = words
        known = options(verb)
        if verb in ("rooms", "data") and rest:
            known = options(verb, rest[0])
        if verb == "train" and rest and not rest[0].startswith("-") and rest[0] != "NAME":
            assert rest[0] in RUNS, f"{page.name}: no run {rest[0]}"
            known += options("train", rest[0])
        for option in (word for word in rest if word.startswith("--")):
            assert re.search(rf"{re.escape(option)}[\s,]", known), f"{page.name}: {verb} {option}"


def test_the_tree_of_the_readme_has_every_file_and_folder_of_the_package():
    tree = (ROOT / "README.md").read_text().partition("src/mvsam/\n")[2].partition("```")[0]
    named = set(re.findall(r"^  (\S+)", tree, re.M))
    files = {path.name for path in SOURCE.glob("*.py")} - {"__init__.py"}
    folders = {f"{path.parent.name}/" for path in SOURCE.glob("*/__init__.py")}
    assert files | folders | {"assets/"} == named


VERBS = [
    "demo",
    "predict",
    "train",
    "eval",
    "models",
    "reconstruct",
    "report",
    "view",
    "rooms export",
    "data check",
    "data convert",
    "data scannet",
    "export",
    "table",
    "bench",
]


@PAGE
def test_every_option_named_in_the_text_is_one_of_some_verb(page: Path):
    known = "".join(options(*verb.split()) for verb in VERBS)
    known += options("train", "tiny_nyu_semantic") + options("train", "base_rooms")
    for option in re.findall(r"`(--[a-z][\w.-]*)", page.read_text()):
        assert re.search(rf"{re.escape(option)}[\s,]", known), f"{page.name}: {option}"


def test_commands_are_found_in_blocks_and_in_the_text():
    text = "Type `mvsam models --json`.\n```\nmvsam demo --out x  # so\n```\n"
    assert commands(text) == [["models", "--json"], ["demo", "--out", "x"]]
    assert sum(len(commands(page.read_text())) for page in PAGES) > 25


@PAGE
def test_every_make_target_of_the_documentation_exists(page: Path):
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M)
    for target in re.findall(r"(?:^|`)make ([a-z-]+)", page.read_text(), re.M):
        assert target in targets


def our_texts() -> str:
    """Every text in the package's code, f-strings with a gap where a value goes."""
    texts = []
    for file in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.JoinedStr):
                parts = [v.value if isinstance(v, ast.Constant) else "\0" for v in node.values]
                texts.append("".join(map(str, parts)))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    return "\n".join(texts)


def test_every_explained_message_is_one_of_ours():
    page = (ROOT / "docs/data.md").read_text()
    rows = page.partition("| The sentence says |")[2].partition("\n\n")[0].splitlines()[2:]
    texts, quotes = (
        our_texts(),
        [q for row in rows for q in re.findall(r"`([^`]+)`", row.split("|")[1])],
    )
    assert len(quotes) > 30
    for quote in quotes:
        assert quote in texts


def test_the_page_of_tables_says_what_the_results_say():
    claims = runpy.run_path(str(ROOT / "benchmarks" / "claims.py"))
    made, written = claims["page"]("rooms", ROOT / "results"), (ROOT / "docs/tables.md").read_text()
    without_commit = [re.sub(r"at commit \w+\+?", "", text) for text in (made, written)]
    assert without_commit[0] == without_commit[1], "make it anew: see the page's first line"


def test_the_rows_among_the_claims_are_those_of_the_results():
    page = (ROOT / "docs/claims.md").read_text()
    rows = re.findall(r"^\|[^|]*\(`(\w+)`\) \|(.*)\|$", page, re.M)
    lines = {line.row.run: line for line in lines_of(TABLES[5], "rooms", ROOT / "results")}
    assert len(rows) == 5
    for name, cells in rows:
        figures = [
            (measured_text(lines[name], metric), unit)
            for metric, unit in (("abs", " cm"), ("rel", " %"), ("miou", " %"))
        ]
        expected = ["" if figure == "-" else figure + unit for figure, unit in figures]
        assert [cell.strip() for cell in cells.split("|")] == expected, name


def test_the_folder_shown_is_the_sample_room():
    page = (ROOT / "docs/data.md").read_text()
    for name in ("intrinsics.txt", "poses/0000.txt"):
        assert (SAMPLE / name).read_text() in page
    assert "".join((SAMPLE / "views.txt").read_text().splitlines(keepends=True)[:3]) in page


def test_the_worked_example_of_the_conventions_adds_up():
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs/conventions.md").read_text(), re.S)
    values: dict = {}
    exec(code, values)
    assert values["opencv"].tolist() == np.loadtxt(SAMPLE / "intrinsics.txt").tolist()
    assert np.allclose(values["world_from_cam"], np.loadtxt(SAMPLE / "poses/0000.txt"))


def test_the_three_lines_of_the_readme_run(random_weights: Path, monkeypatch):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    load = weights.load
    monkeypatch.setattr(weights, "load", lambda name: load(str(random_weights)))
    generator = np.random.default_rng(0)
    pose = np.eye(4)
    pose[0, 3] = 0.1
    values: dict = {
        "images": [generator.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(2)],
        "intrinsics": [np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]])] * 2,
        "world_from_cam": [np.eye(4), pose],
    }
    exec(code, values)
    assert values["depth"].shape == values["labels"].shape == (48, 64)


def run_example(name: str, monkeypatch, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    runpy.run_path(str(ROOT / "examples" / name), run_name="__main__")


def test_examples_stay_short():
    examples = list((ROOT / "examples").glob("*.py"))
    assert len(examples) == 4
    for example in examples:
        assert len(example.read_text().splitlines()) < 60


def test_example_predict_folder(random_weights: Path, tmp_path: Path, monkeypatch, capsys):
    write_posed_folder(tmp_path / "room", 2, (64, 48))
    out = tmp_path / "out"
    folder, model = str(tmp_path / "room"), str(random_weights)
    run_example("predict_folder.py", monkeypatch, folder, "--model", model, "--out", str(out))
    assert len(list(out.glob("*_labels.png"))) == 2
    depth = np.load(next(iter(out.glob("*_depth.npy"))))
    assert depth.shape == (48, 64) and 0.1 <= depth.min() <= depth.max() <= 6
    assert capsys.readouterr().out.count("median depth") == 2


def test_example_change_a_part(monkeypatch, capsys):
    run_example("change_a_part.py", monkeypatch, "--depth", "1", "--size", "64", "32")
    assert "depth (1, 32, 64), logits (1, 20, 32, 64)" in capsys.readouterr().out


def test_example_render_rooms(tmp_path: Path, monkeypatch):
    arguments = ("--rooms", "rooms:val:0-2", "--frames", "2", "--out", str(tmp_path))
    run_example("render_rooms.py", monkeypatch, *arguments)
    assert mvsam.open_scene(tmp_path / "0001").frame(1).depth is not None
    assert (tmp_path / "preview.png").is_file()
