"""The exceptions by which a run ends early, with their exit codes; and texts that messages share: errors, particles, steps."""

from collections.abc import Sequence
from operator import index
from typing import Any

EXIT_ON_SIGNAL = 130
MOST_NAMED = 5  # particles or pairs named in a fault
LONGEST_REASON = 400  # characters of an unexpected error that are printed


class SceneError(ValueError):
    """A scene, or arguments, that cannot be run: one line a fault, each naming its key (exit code 2)."""

    exit_code = 2

    def __init__(self, faults: str | list[str]):
        self.faults = [faults] if isinstance(faults, str) else faults
        super().__init__("\n".join(self.faults))


class StoppedError(RuntimeError):
    """The run stopped itself: a state that has lost its meaning, or a file that cannot be written (exit code 3)."""

    exit_code = 3


class StateError(StoppedError):
    """A state that has lost its meaning: a particle is lost, astray, or not a number."""


class Interrupted(Exception):
    """Stopped by a signal or the wall-time limit, after writing a checkpoint."""

    exit_code = EXIT_ON_SIGNAL


def one_line(error: BaseException) -> str:
    """What an error says, on one line, cut after LONGEST_REASON characters.

    All its lines are joined, because an error of numba gives its reason after the first line.
    """
    said = " ".join(str(error).split())
    return said if len(said) <= LONGEST_REASON else f"{said[:LONGEST_REASON]} ..."


def listed(names: Sequence[Any] | Any, what: str = "particle", total: int | None = None) -> str:
    """ "particle 3", "particles 3 and 7", "particles 0, 1, 2, 3, 4 and 12 more"; `names`: the first of `total`, or all."""
    total = len(names) if total is None else total
    parts = [str(name) for name in names[:MOST_NAMED]] + ([f"{total - MOST_NAMED} more"] if total > MOST_NAMED else [])
    text = parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
    return f"{what}{'s' if total > 1 else ''} {text}"


def whole_number(name: str, value: Any, least: int = 0) -> int:
    """A number of steps that a user gave, as an integer of at least that size. ValueError, with the name, for what is none."""
    try:
        number = index(value)
    except TypeError:
        number = least - 1
    if number < least:
        raise ValueError(f"{name}: {value!r} is not a number of steps" + (f", {least} or more" if least else ""))
    return number
