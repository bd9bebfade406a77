"""Scores under named protocols."""

from mvsam.evaluation.evaluate import Scores, evaluate
from mvsam.evaluation.protocols import PROTOCOLS, Protocol

__all__ = ["PROTOCOLS", "Protocol", "Scores", "evaluate"]
