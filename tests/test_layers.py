"""Who imports whom, from the bottom up, and that importing does nothing else."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import mvsam

PACKAGE = Path(mvsam.__file__).parent  # pyright: ignore[reportArgumentType]

NETWORK = {"encoders", "mvs", "segmentation"}
CONVOLUTION = {"convolution", "convolution_gradient"}
BASE = {
    "types",
    "errors",
    "files",
    "kernels",
    "memory",
    "precision",
    "provenance",
    "device",
} | CONVOLUTION
MODELS = BASE | {"geometry", "model", "assemblies", "build", "weights"}
ALLOWED: dict[str, set[str]] = {
    "types": set(),
    "errors": set(),
    "memory": set(),
    "precision": set(),
    "device": {"errors"},
    "kernels": set(),
    "convolution_gradient": {"kernels"},
    "convolution": {"convolution_gradient"},
    "provenance": set(),
    "files": {"errors"},
    "grid_filter": set(),
    "loss_terms": {"types"},
    "geometry": {"types"},
    "encoders": {"types", "errors", "files", "geometry", "convolution"},
    "mvs": {"types", "geometry", "kernels"} | CONVOLUTION,
    "segmentation": {"types", "geometry"},
    "model": {"types", "geometry", *NETWORK},
    "baselines": {"types", "errors", "loss_terms", "geometry", "convolution", "encoders", "mvs"},
    "assemblies": {"types", "errors", "grid_filter", "model", "baselines", *NETWORK},
    "build": {"types", "errors", "assemblies", "baselines"},
    "weights": {"types", "errors", "files", "build", "model", *NETWORK},
    "rooms": {"types", "errors", "files", "geometry"},
    "data": {"types", "errors", "files", "geometry"},
    "reconstruction": {"types", "errors", "files", "geometry"},
    "evaluation": {"types", "errors", "precision"},
    "training": {"types", "errors", "precision", "loss_terms", "evaluation"},
    "inference": MODELS | {"data", "evaluation", "reconstruction"},
    "experiments": MODELS
    | {"encoders", "mvs", "baselines", "loss_terms", "data", "training", "evaluation"},
}
"""What each part may import; `apps`, `commands` and `cli` lie above them all, in this order."""

EXCEPTIONS = {("data/catalog.py", "rooms")}
"""Names `rooms:*` are data; what opens data by name calls the rooms."""

TOP = ["apps", "commands", "cli"]


def allowed(part: str) -> set[str]:
    if part in TOP:
        return set(ALLOWED) | set(TOP[: TOP.index(part)])
    return ALLOWED[part]


def part_of(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported_parts(file: Path) -> set[str]:
    """First names below `mvsam` that a file imports, wherever in it."""
    found = set()
    package = ("mvsam", *file.relative_to(PACKAGE).parent.parts)
    for node in ast.walk(ast.parse(file.read_text())):
        modules = []
        if isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*above, *([node.module] if node.module else [])])
            is_package = module == "mvsam"
            modules = [f"mvsam.{alias.name}" for alias in node.names] if is_package else [module]
        found |= {name.split(".")[1] for name in modules if name.startswith("mvsam.")}
    return found


FILES = sorted(
    path for path in PACKAGE.rglob("*.py") if path.parent != PACKAGE or path.stem != "__init__"
)


def test_every_part_has_a_place_in_the_order():
    parts = {part_of(file) for file in FILES} - {"__main__"}
    assert parts <= set(ALLOWED) | set(TOP)


def test_the_order_has_no_circle():
    placed: set[str] = set()
    waiting = dict(ALLOWED)
    while waiting:
        ready = {part for part, below in waiting.items() if below <= placed}
        assert ready, f"these import each other: {sorted(waiting)}"
        placed |= ready
        waiting = {part: below for part, below in waiting.items() if part not in ready}


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_lower_layers_never_import_upper_ones(file: Path):
    part = part_of(file)
    name = file.relative_to(PACKAGE).as_posix()
    for other in imported_parts(file) - {part}:
        assert other in allowed(part) or (name, other) in EXCEPTIONS, f"{name} imports {other}"


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_no_file_imports_a_star_or_edits_the_path(file: Path):
    text = file.read_text()
    assert "sys.path" not in text
    stars = [
        node
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom) and any(alias.name == "*" for alias in node.names)
    ]
    assert not stars


def loaded_by(statement: str) -> set[str]:
    script = f"import sys; {statement}; print(*sys.modules)"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return {name.split(".")[0] for name in result.stdout.split()}


def test_importing_the_package_loads_neither_torch_nor_extras():
    assert not loaded_by("import mvsam") & {"torch", "lightning", "embreex", "trimesh", "timm"}


EXTRAS = {
    "lightning": {"training", "experiments"},
    "tensorboard": {"experiments"},
    "embreex": {"rooms"},
    "onnx": set(),
    "onnxruntime": set(),
    "onnxscript": set(),
    "trimesh": {"rooms"},
}
"""Optional libraries and the parts that may import them as soon as they are imported."""


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_optional_libraries_are_imported_where_they_are_used_and_not_before(file: Path):
    for node in ast.parse(file.read_text()).body:  # what runs when the file is imported
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names = [node.module or ""]
        for name in names:
            library = name.split(".")[0]
            assert part_of(file) in EXTRAS.get(library, {part_of(file)}), f"{file} imports {name}"
