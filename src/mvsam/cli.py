"""`mvsam VERB`: finds the verb, runs it, and turns every error into one sentence.

Exit codes: 0 done, 1 a failure, 2 bad input, 130 stopped with Ctrl-C, 141 who read the output (as
`| head`) has seen enough.
"""

import logging
import os
import sys
import traceback
from collections.abc import Sequence
from typing import Annotated

import tyro

from mvsam.commands.bench import Bench
from mvsam.commands.data import Data
from mvsam.commands.demo import Demo
from mvsam.commands.evaluate import Evaluate
from mvsam.commands.export import Export
from mvsam.commands.models import Models
from mvsam.commands.predict import Predict
from mvsam.commands.reconstruct import Reconstruct
from mvsam.commands.report import Report
from mvsam.commands.rooms import Rooms
from mvsam.commands.table import Table
from mvsam.commands.train import Train
from mvsam.commands.view import View
from mvsam.errors import InputError, MissingExtraError
from mvsam.files import DiskFullError

Verb = (
    Annotated[Demo, tyro.conf.subcommand("demo")]
    | Annotated[Predict, tyro.conf.subcommand("predict")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Evaluate, tyro.conf.subcommand("eval")]
    | Annotated[Table, tyro.conf.subcommand("table")]
    | Annotated[Models, tyro.conf.subcommand("models")]
    | Annotated[Reconstruct, tyro.conf.subcommand("reconstruct")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[View, tyro.conf.subcommand("view")]
    | Annotated[Rooms, tyro.conf.subcommand("rooms")]
    | Annotated[Data, tyro.conf.subcommand("data")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
)

DESCRIPTION = """Metric depth and semantic maps from a few posed photographs.

mvsam VERB --help explains a verb. With --debug anywhere an error shows where it happened;
--version prints the version."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command line (without the program's name) and returns its exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    wants_traceback = "--debug" in arguments
    arguments = [argument for argument in arguments if argument != "--debug"]
    _show_messages()
    try:
        _run_and_flush(arguments)
    except BrokenPipeError:
        _discard_output()
        return 141
    except SystemExit as request:  # how tyro ends --help and wrong options
        return request.code if isinstance(request.code, int) else 0
    except KeyboardInterrupt:
        _complain("stopped; what was written is whole, and the same command goes on from there.")
        return 130
    except Exception as error:
        if wants_traceback:
            traceback.print_exc()
        _complain(_sentence(error))
        return 2 if isinstance(error, InputError | MissingExtraError) else 1
    return 0


def _run_and_flush(arguments: list[str]) -> None:
    """A closed pipe is noticed here, not when Python ends."""
    try:
        _run(arguments)
    finally:
        sys.stdout.flush()


def _discard_output() -> None:
    """What is still in the buffer would else be complained of when Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _run(arguments: list[str]) -> None:
    if arguments[:1] == ["--version"]:
        from importlib.metadata import version

        print(f"mvsam {version('mvsam')}")
        return
    if arguments[:1] == ["train"]:
        Train.parse(arguments[1:]).run()
        return
    verb = tyro.cli(
        Verb,  # pyright: ignore[reportArgumentType]
        prog="mvsam",
        description=DESCRIPTION,
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    verb.run()


def _sentence(error: Exception) -> str:
    """What the user is told: our own sentences as they are, others with their kind."""
    if isinstance(error, InputError | MissingExtraError | DiskFullError):
        return str(error)
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text} (--debug shows where)"


def _complain(sentence: str) -> None:
    print(f"error: {sentence}", file=sys.stderr)


class _Messages(logging.Handler):
    """Prints to the stderr of the moment, which a progress bar replaces."""

    def emit(self, record: logging.LogRecord) -> None:
        kind = "warning: " if record.levelno >= logging.WARNING else ""
        print(f"{kind}{record.getMessage()}", file=sys.stderr)


def _show_messages() -> None:
    log = logging.getLogger("mvsam")
    log.setLevel(logging.INFO)
    if not any(isinstance(handler, _Messages) for handler in log.handlers):
        log.addHandler(_Messages())


if __name__ == "__main__":
    sys.exit(main())
