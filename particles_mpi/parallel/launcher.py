"""Starts mpirun and removes from its stderr the paragraphs about ranks that have printed themselves why they end.

`python particles_mpi/parallel/launcher.py LAUNCHER ARGUMENTS...` is what the mpirun in .venv/bin runs. This process becomes the
launcher, so that signals, stdin, stdout and the exit code are the launcher's own. Its stderr goes through a second process: of
the paragraphs between two lines of dashes, and lines that begin with [host:pid], both by Open MPI, it removes those about an exit
code or MPI_Abort and shortens the one about a signal; all else passes at once. No setting of Open MPI does that:
`orte_execute_quiet` hides also that a rank was killed, or that there is no such program.
"""

import os
import re
import select
import signal
import sys

RULE = b"-" * 74 + b"\n"
PATIENCE = 0.5  # seconds after which what looks like the beginning of a paragraph is passed on, if nothing follows
LONGEST_PARAGRAPH = 4000  # bytes of a paragraph; a longer text is none
KNOWN = re.compile(
    rb"Primary job +terminated normally, but \d+ process"
    rb"|detected that one or more processes exited with non-zero status"
    rb"|MPI_ABORT was invoked on rank"
    rb"|has exited due to process rank \d+ with PID \d+ on node \S+ (calling \"abort\"|exiting)"
)
SIGNAL = re.compile(rb"noticed that process rank (\d+) with PID \d+ on node (\S+) exited on (signal \d+ \([^)]*\))")
STUMBLED = re.compile(rb"\[[^\]]*\] \[\[[^\]]*\],\d+\] ORTE_ERROR_LOG: [^\n]* in file \S*orte/util/show_help.c at line \d+\n")
EVENTS = re.compile(rb"\[warn\] Epoll [^\n]* failed\.[^\n]*\n")  # of its library of events, now and then when ranks end
COUNTED = re.compile(rb"\[[^\]]*\] \d+ more process(es)? ha(s|ve) sent help message help-mpi-api.txt / mpi-abort\n")
ADVICE = re.compile(rb"\[[^\]]*\] Set MCA parameter \"orte_base_help_aggregate\" to 0 to see all help / error messages\n")


class Filter:
    """Takes the bytes of stderr piece by piece and returns those that are to be printed."""

    def __init__(self) -> None:
        self.held = b""  # bytes of a paragraph that has not ended, or of a line that may begin one
        self.at_start = True  # does the next byte begin a line?
        self.counted = False  # was the line before left out as COUNTED?

    def feed(self, data: bytes) -> bytes:
        """The bytes that can be printed now."""
        data, self.held, passed = self.held + data, b"", b""
        while data:
            if self.at_start and (RULE.startswith(data) or data.startswith(RULE)):
                inner, rule, rest = data[len(RULE) - 1 :].partition(b"\n" + RULE)
                if rule:
                    passed += self.paragraph(RULE[:-1] + inner + rule)
                    data = rest
                    continue
                if len(data) < LONGEST_PARAGRAPH:
                    self.held = data
                    break
            if self.at_start and data[:1] == b"[" and not re.search(rb"[\r\n]", data):  # "[host:pid] ..." has to be seen whole
                self.held = data
                break
            if self.at_start and data[:1] == b"\0":  # behind a paragraph of Open MPI 5
                data = data[1:]
                continue
            line, newline, data = data.partition(b"\n")
            passed += self.line(line + newline)
            self.at_start = bool(newline)
        return passed

    def paragraph(self, text: bytes) -> bytes:
        """What is printed of a paragraph of the launcher."""
        said = b" ".join(text.split())
        if killed := SIGNAL.search(said):
            return b"mpirun: rank %s on %s was ended by %s\n" % killed.groups()
        return b"" if KNOWN.search(said) else text

    def line(self, text: bytes) -> bytes:
        """What is printed of a line: nothing if it says how many paragraphs were left out, or that one was not understood."""
        counted, self.counted = self.counted, bool(self.at_start and COUNTED.fullmatch(text))
        own = any(pattern.fullmatch(text) for pattern in (STUMBLED, EVENTS))
        about = self.counted or (counted and ADVICE.fullmatch(text)) or (self.at_start and own)
        return b"" if about else text

    def rest(self) -> bytes:
        """The bytes that were held back, when no more come."""
        held, self.held = self.held, b""
        self.at_start = held.endswith(b"\n") or (not held and self.at_start)
        return held


def relay(source: int) -> None:
    """Pass on what comes from `source` until it is closed; signals are left to the launcher."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1):
        signal.signal(number, signal.SIG_IGN)
    passing = Filter()
    ended = False
    while not ended:
        ready, _, _ = select.select([source], [], [], PATIENCE if passing.held else None)
        data = os.read(source, 65536) if ready else b""
        sys.stderr.buffer.write(passing.feed(data) if data else passing.rest())
        sys.stderr.buffer.flush()
        ended = bool(ready) and not data


def main() -> None:
    """Start the second process, detached from this one, and become the launcher."""
    source, end = os.pipe()
    child = os.fork()
    if child == 0:
        if os.fork() == 0:
            for descriptor in (0, 1, end):
                os.close(descriptor)
            try:
                relay(source)
            finally:
                os._exit(0)
        os._exit(0)
    os.waitpid(child, 0)
    stderr = os.dup(2)
    os.dup2(end, 2)
    try:
        os.execv(sys.argv[1], sys.argv[1:])
    except OSError as error:
        os.dup2(stderr, 2)
        sys.exit(f"{sys.argv[1]}: {error.strerror}")


if __name__ == "__main__":
    main()
