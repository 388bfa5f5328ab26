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
GRACE = 0.4  # seconds that a step has to end after a signal, where `check_signals` is called within it
POLL_STEPS, POLL_SECONDS = 10, 0.2  # between two polls of all ranks: whichever is less


def exit_on_signals() -> None:
    """From here on a signal ends the process; an exception would wait for the other ranks in MPI_Finalize."""
    for number in SIGNALS:
        signal.signal(number, lambda *_: os._exit(EXIT_ON_SIGNAL))


class SignalCaught:
    """Remembers when the first signal came, for `check_signals`."""

    asked_at = np.inf

    def ask(self, *_: object) -> None:
        """What a signal calls."""
        self.asked_at = min(self.asked_at, perf_counter())


class StopRequest(SignalCaught):
    """Was the run asked to stop, by a signal, or by `wall_time` seconds since `began`? Holds the signals until `close`."""

    def __init__(self, ranks: Communicator, began: float, wall_time: float | None):
        self.ranks = ranks
        self.end = np.inf if wall_time is None else began + wall_time
        self.reserve = 0.0  # seconds before the end that a checkpoint needs
        self.polled, self.step, self.next = perf_counter(), 0, 0
        caught = SIGNALS if current_thread() is main_thread() else ()  # no other thread may catch any
        self.before = {number: signal.signal(number, self.ask) for number in caught}
        _requests.append(self)

    def poll(self, step: int) -> bool:
        """Was any rank asked to stop, or is the time over? Ranks compare every few steps, if these are short. Collective."""
        if step < self.next:
            return False
        now = perf_counter()
        pace = (now - self.polled) / max(step - self.step, 1)
        stop, pace = self.ranks.allreduce_max(np.array([self.asked_at < np.inf or now + self.reserve > self.end, pace]))
        self.polled, self.step = now, step
        self.next = step + int(min(max(POLL_SECONDS / max(pace, 1e-9), 1), POLL_STEPS))
        return bool(stop)

    def close(self) -> None:
        """Give the signals back their former meaning."""
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
            set_handler(signal.SIGINT, self.ask)
            _requests.append(self)

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self.held:
            _requests.remove(self)
            set_handler(signal.SIGINT, signal.default_int_handler)
            if self.asked_at < np.inf and kind is None:
                raise KeyboardInterrupt


_requests: list[SignalCaught] = []  # those that catch signals at present


def check_signals() -> None:
    """For the middle of long computations: raises KeyboardInterrupt if a signal came more than GRACE seconds ago."""
    for request in _requests:
        if perf_counter() > request.asked_at + GRACE:
            raise KeyboardInterrupt("stopped within a step that takes long: what counts is the last checkpoint")
