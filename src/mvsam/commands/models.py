"""`mvsam models`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mvsam.commands.shared import Json, print_json, print_table
from mvsam.errors import MissingExtraError


@dataclass(frozen=True)
class Models:
    """Every model: its row in the paper's tables, inputs, tasks and parameters.

    Parameters count every weight, frozen or not, for 20 classes. "weights" names those that come
    with the package, as other commands take them.

    Example: mvsam models --json
    """

    json: Json = False

    def run(self) -> None:
        from rich.table import Table

        models = describe_models()
        if self.json:
            print_json(models)
            return
        table = Table("name", "paper", "inputs", "tasks", "weights")
        table.add_column("parameters", justify="right")
        for model in models:
            table.add_row(
                model["name"],
                model["paper_row"],
                model["inputs"],
                ", ".join(model["tasks"]),
                ", ".join(model["weights"]),
                f"{model['parameters']:,}" if model["parameters"] else "needs mvsam[baselines]",
            )
        print_table(table)


def describe_models() -> list[dict[str, Any]]:
    """What `mvsam models --json` prints; `parameters` is null where an extra is missing."""
    from mvsam.build import MODELS
    from mvsam.weights import ASSETS, embedded, read_info

    models = {name: read_info(ASSETS / f"{name}.json").model for name in embedded()}
    return [
        {
            "name": name,
            "parameters": _parameters(name),
            "paper_row": spec.paper_row,
            "inputs": spec.inputs,
            "tasks": list(spec.tasks),
            "input_size": list(spec.input_size),
            "weights": [weights for weights, model in models.items() if model == name],
        }
        for name, spec in MODELS.items()
    ]


def _parameters(name: str) -> int | None:
    """None where the library that the model is made of is not installed."""
    from mvsam.build import count_parameters

    try:
        return count_parameters(name)
    except MissingExtraError:
        return None
