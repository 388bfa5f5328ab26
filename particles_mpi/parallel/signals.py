"""Ctrl-C, SIGTERM, SIGUSR1 and the wall-time limit: first they end the program, later they ask a run for a checkpoint."""

from __future__ import annotations

import os
import signal
from _signal import getsignal  # type: ignore[import-not-found]
from _signal import signal as set_handler
from threading import current_thread, main_thread
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from particles_mpi.errors import EXIT_ON_SIGNAL

if TYPE_CHECKING:  # signals are caught before anything that takes long is imported
    from particles_mpi.parallel.communicator import Communicator

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)  # the last: of a scheduler, before the end of a job
GRACE = 0.4  # seconds that a step has to end after a signal, where `check_signals` is called within it; and, if steps take long,
AS_BEFORE, LONGEST_GRACE = 2.0, 20.0  # times the one before, but no more than so many seconds: after 30 Slurm kills
POLL_STEPS, POLL_SECONDS = 10, 0.2  # between two polls of all ranks: whichever is less


def exit_on_signals() -> None:
    """Let signals end the process from now on; an exception would wait for the other ranks in MPI_Finalize."""
    for number in SIGNALS:
        signal.signal(number, lambda *_: os._exit(EXIT_ON_SIGNAL))


class SignalCaught:
    """Keeps the time of the first signal, for `check_signals`, and how many seconds (`grace`) a step has to end after it."""

    signalled_at, begun, grace = np.inf, -np.inf, GRACE  # begun: when the present step did

    def note_signal(self, *_: object) -> None:
        """The signal handler: note the time of the first signal."""
        self.signalled_at = min(self.signalled_at, perf_counter())


class StopRequest(SignalCaught):
    """Was the run asked to stop, by a signal, or by `wall_time` seconds since `began`? Holds the signals until `close`."""

    def __init__(self, ranks: Communicator, began: float, wall_time: float | None):
        self.ranks = ranks
        self.end = np.inf if wall_time is None else began + wall_time
        self.reserve = 0.0  # seconds before the end that a checkpoint needs
        self.enough = False  # has this rank seen all that it wanted to see? Then the run ends as after a signal
        self.polled, self.step, self.next = perf_counter(), 0, 0
        caught = SIGNALS if current_thread() is main_thread() else ()  # no other thread may catch any
        self.before = {number: signal.signal(number, self.note_signal) for number in caught}
        _requests.append(self)

    def poll(self, step: int) -> bool:
        """Was any rank asked to stop, or is the time over? Ranks compare every few steps, if these are short. Collective."""
        if step < self.next:
            return False
        now = perf_counter()
        pace = (now - self.polled) / max(step - self.step, 1)
        over = self.enough or self.signalled_at < np.inf or now + self.reserve > self.end
        stop, pace = self.ranks.allreduce_max(np.array([over, pace]))
        self.polled, self.step = now, step
        self.next = step + int(min(max(POLL_SECONDS / max(pace, 1e-9), 1), POLL_STEPS))
        return bool(stop)

    def __enter__(self) -> None:
        """Note that a step begins, or several that are computed at once."""
        self.begun = perf_counter()

    def __exit__(self, *_: object) -> None:
        """Give the next step twice the time of this one, after a signal. A first step, which may compile, soon counts no more."""
        self.grace = max(GRACE, min(AS_BEFORE * (perf_counter() - self.begun), LONGEST_GRACE))

    def close(self) -> None:
        """Restore the former signal handlers."""
        _requests.remove(self)
        for number, handler in self.before.items():
            signal.signal(number, handler)


class HeldInterrupt(SignalCaught):
    """For a block that should not be left halfway: Ctrl-C, if it would raise KeyboardInterrupt, does so at the end of it.

    `check_signals` within the block does so earlier, after GRACE seconds. A step is such a block: handlers are read and set by
    `_signal`, for the functions of the same names in `signal` look for the names of handlers first, which takes 18 us a step.
    """

    def __enter__(self) -> None:
        self.held = getsignal(signal.SIGINT) is signal.default_int_handler and current_thread() is main_thread()
        if self.held:
            set_handler(signal.SIGINT, self.note_signal)
            _requests.append(self)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self.held:
            _requests.remove(self)
            set_handler(signal.SIGINT, signal.default_int_handler)
            if self.signalled_at < np.inf and kind is None:
                raise KeyboardInterrupt


_requests: list[SignalCaught] = []  # those that catch signals at present


def check_signals() -> None:
    """For the middle of long computations: raises KeyboardInterrupt if a step goes on for too long after a signal.

    A signal that came before the step began, as while a frame was written, leaves the step as much time as one that comes then.
    """
    for request in _requests:
        if perf_counter() > max(request.signalled_at, request.begun) + request.grace:
            raise KeyboardInterrupt("stopped in the middle of a long step: continue from the last checkpoint")
