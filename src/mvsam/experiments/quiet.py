"""Keeps Lightning to what a user of this package can act on."""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

_NEEDLESS = (
    ".*does not have many workers.*",
    ".*resuming from a checkpoint.*",
    ".*exists and is not empty.*",
    ".*LeafSpec.*",
    ".*persistent_workers.*",
)
"""Warnings that say nothing about such a run."""


@contextmanager
def quiet_lightning() -> Iterator[None]:
    """Leaves out its advertisements, and advice that does not apply.

    The stream goes on exactly where it stopped, and a folder that is not empty is how a run goes
    on.
    """
    loggers = [logging.getLogger(name) for name in ("lightning.pytorch", "lightning.fabric")]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        for text in _NEEDLESS:
            warnings.filterwarnings("ignore", text)
        for logger in loggers:
            logger.setLevel(logging.WARNING)
        try:
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)
