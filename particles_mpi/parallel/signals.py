"""Ctrl-C, SIGTERM and the wall-time limit: before anything is written they end the program, then they ask for a checkpoint."""

from __future__ import annotations

import os
import signal
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from particles_mpi.errors import EXIT_ON_SIGNAL

if TYPE_CHECKING:  # signals are caught before anything that takes long is imported
    from particles_mpi.parallel.communicator import Communicator

SIGNALS = (signal.SIGINT, signal.SIGTERM)
GRACE = 0.4  # seconds for a step to end after a signal, if it looks in between
LOOK_STEPS, LOOK_SECONDS = 10, 0.2  # between two looks whether a rank was told to stop: whichever is less


def exit_on_signals() -> None:
    """End the process on a signal, as long as there is nothing to save; its launcher then ends the other ranks.

    An exception instead would have to pass through MPI_Finalize, which waits for them.
    """
    for number in SIGNALS:
        signal.signal(number, lambda *_: os._exit(EXIT_ON_SIGNAL))


class StopRequest:
    """Asked to stop? Catches the signals from its making to `close`; `wall_time` (s, if any) counts from `began`."""

    def __init__(self, ranks: Communicator, began: float, wall_time: float | None):
        self.ranks, self.asked = ranks, False
        self.end = np.inf if wall_time is None else began + wall_time
        self.looked, self.step, self.next = perf_counter(), 0, 0
        self.asked_at = np.inf
        self.before = {number: signal.signal(number, self._tell) for number in SIGNALS}
        _requests.append(self)

    def _tell(self, *_: object) -> None:
        self.asked, self.asked_at = True, min(self.asked_at, perf_counter())

    def poll(self, step: int) -> bool:
        """Was any rank told to stop, or is the time up? Looks every few steps, all ranks at the same ones. Collective.

        mpirun kills its ranks a few seconds after it was told to stop, so where steps take long every one looks.
        """
        if step < self.next:
            return False
        now = perf_counter()
        pace = (now - self.looked) / max(step - self.step, 1)
        stop, pace = self.ranks.allreduce_max(np.array([self.asked or now > self.end, pace]))
        self.looked, self.step = now, step
        self.next = step + int(np.clip(LOOK_SECONDS / max(pace, 1e-9), 1, LOOK_STEPS))
        return bool(stop)

    def close(self) -> None:
        """Signals mean again what they did before."""
        _requests.remove(self)
        for number, handler in self.before.items():
            signal.signal(number, handler)


_requests: list[StopRequest] = []  # those that catch signals now


def check_signals() -> None:
    """Called between the pieces of a long computation within a step, which ends here if a signal came some time ago."""
    for request in _requests:
        if perf_counter() > request.asked_at + GRACE:
            raise KeyboardInterrupt("stopped within a step that takes long: what counts is the last checkpoint")
