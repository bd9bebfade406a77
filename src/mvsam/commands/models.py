"""`mvsam models`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mvsam.commands.shared import Json, print_json, print_table


@dataclass(frozen=True)
class Models:
    """Every model: its row in the paper's tables, inputs, tasks and parameters.

    Parameters count every weight, frozen or not, for 20 classes.

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
                "embedded" if model["has_weights"] else "",
                f"{model['parameters']:,}",
            )
        print_table(table)


def describe_models() -> list[dict[str, Any]]:
    """What `mvsam models --json` prints."""
    from mvsam.build import MODELS, count_parameters
    from mvsam.weights import embedded

    with_weights = embedded()
    return [
        {
            "name": name,
            "parameters": count_parameters(name),
            "paper_row": spec.paper_row,
            "inputs": spec.inputs,
            "tasks": list(spec.tasks),
            "input_size": list(spec.input_size),
            "has_weights": name in with_weights,
        }
        for name, spec in MODELS.items()
    ]
