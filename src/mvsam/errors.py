"""The errors a user meets: one clear sentence, never a bare traceback."""


def counted(number: int, noun: str) -> str:
    """As "1 photo" or "2 photos"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


class InputError(ValueError):
    """Bad input: the sentence names the item and says what to do (exit code 2)."""


class MissingExtraError(ImportError):
    """An optional library is not installed (exit code 2)."""

    def __init__(self, feature: str, library: str, extra: str):
        super().__init__(f"{feature} needs {library}: pip install 'mvsam[{extra}]'")
