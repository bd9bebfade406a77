from torch import nn


def count(module: nn.Module) -> int:
    """Parameters, frozen or not."""
    return sum(parameter.numel() for parameter in module.parameters())
