"""The three ways in which a run ends early, and their exit codes."""

EXIT_ON_SIGNAL = 130


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
