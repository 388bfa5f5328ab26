"""Starts mpirun, ends it in a way in which a run can save, and removes its paragraphs about ranks that explain their end
themselves.

`python particles_mpi/parallel/launcher.py LAUNCHER ARGUMENTS...` is what the mpirun in .venv/bin runs. stdin, stdout and the exit
code are the launcher's own.

Signals. On Ctrl-C Open MPI's mpirun stops to pass on what ranks print, waits, sends the ranks a signal, waits, and kills them; a
second Ctrl-C kills them at once. So SIGINT, SIGTERM and SIGHUP are blocked in mpirun, and come to this process alone. It sends
SIGUSR1 to mpirun, which passes it to the ranks at once; a run then saves and ends. At the second signal it prints that a third
one kills the ranks, which the third one does.

Messages. Open MPI prints paragraphs between two lines of dashes, and lines that begin with [host:pid]. Those about MPI_Abort or
an exit code of this program are removed, and those about a signal or another exit code are shortened; all else passes at once. No
setting of Open MPI does that: `orte_execute_quiet` also hides that a rank was killed, or that there is no such program.

Its own end. When a rank has ended all of them while another one is in MPI_Finalize, the mpirun of Open MPI 4 sometimes crashes,
or waits for itself for ever, with all ranks gone (twice in 500 times on a busy machine). It has printed its exit code before, and
this process ends with that.
"""

import os
import re
import select
import signal
import sys
from contextlib import suppress
from ctypes import CDLL
from typing import NoReturn

RULE = b"-" * 74 + b"\n"
PATIENCE = 0.5  # seconds after which what looks like the beginning of a paragraph is passed on, if nothing follows
STUCK = 5.0  # seconds without a word, and without ranks, after which an mpirun that has said how it ends is killed
EXIT_ON_SIGNAL = 130  # `errors.EXIT_ON_SIGNAL`; this script imports nothing of the package
PR_SET_PDEATHSIG = 1  # prctl(2): the signal that a process gets when its parent has ended
LONGEST_PARAGRAPH = 4000  # bytes of a paragraph; a longer text is none
KNOWN = re.compile(
    rb"Primary job +terminated normally, but \d+ process"
    rb"|detected that one or more processes exited with non-zero status"
    rb"|MPI_ABORT was invoked on rank"
    rb"|has exited due to process rank \d+ with PID \d+ on node \S+ (calling \"abort\"|exiting)"
)
EXITED = re.compile(rb"Process name: \[\S*,(\d+)\] Exit code: (\d+)")
ABORTED = re.compile(rb"MPI_ABORT was invoked .*[Ee]rrorcode:? (\d+)")
SPEAKING = (b"1", b"2", b"3", b"130")  # exit codes of Python, and of this program, with which a rank says why it ends
SIGNAL = re.compile(rb"noticed that process rank (\d+) with PID \d+ on node (\S+) exited on (signal (\d+) \([^)]*\))")
STUMBLED = re.compile(rb"\[[^\]]*\] \[\[[^\]]*\],\d+\] ORTE_ERROR_LOG: [^\n]* in file \S*orte/util/show_help.c at line \d+\n")
EVENTS = re.compile(rb"\[warn\] Epoll [^\n]* failed\.[^\n]*\n")  # of its library of events, now and then when ranks end
FORWARDED = re.compile(rb"mpirun[^\n]*: Forwarding signal \d+ to job\n")
COUNTED = re.compile(rb"\[[^\]]*\] \d+ more process(es)? ha(s|ve) sent help message help-mpi-api.txt / mpi-abort\n")
ADVICE = re.compile(rb"\[[^\]]*\] Set MCA parameter \"orte_base_help_aggregate\" to 0 to see all help / error messages\n")


class Filter:
    """Takes the bytes of stderr of the mpirun with this process id, piece by piece, and returns those that are to be printed.

    code: with which it will end, as soon as it has said that; None before.
    """

    def __init__(self, pid: int = 0) -> None:
        self.pid = pid
        self.code: int | None = None
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
            own = data[:1] == b"[" or b"mpirun".startswith(data[:6])  # "[host:pid] ...", "mpirun: ..." have to be seen whole
            if self.at_start and own and not re.search(rb"[\r\n]", data):
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
        killed, exited, aborted = (pattern.search(said) for pattern in (SIGNAL, EXITED, ABORTED))
        codes = [128 + int(killed[4])] if killed else [int(exited[2])] if exited else [int(aborted[1])] if aborted else []
        self.code = next(iter(codes), None) if self.code is None else self.code
        if killed:
            return b"mpirun: rank %s on %s was ended by %s\n" % killed.groups()[:3]
        if exited and exited[2] not in SPEAKING:
            return b"mpirun: rank %s ended with exit code %s\n" % exited.groups()
        return b"" if KNOWN.search(said) else text

    def line(self, text: bytes) -> bytes:
        """What is printed of a line: nothing if it says how many paragraphs were left out, or that one was not understood, or
        where mpirun itself crashed when it had said how it ends."""
        counted, self.counted = self.counted, bool(self.at_start and COUNTED.fullmatch(text))
        own = any(pattern.fullmatch(text) for pattern in (STUMBLED, EVENTS, FORWARDED))
        own = own or (self.code is not None and bool(re.match(rb"\[[^\]]*:%d\] " % self.pid, text)))
        about = self.counted or (counted and ADVICE.fullmatch(text)) or (self.at_start and own)
        return b"" if about else text

    def rest(self) -> bytes:
        """The bytes that were held back, when no more come."""
        held, self.held = self.held, b""
        self.at_start = held.endswith(b"\n") or (not held and self.at_start)
        return held


class Launcher:
    """The mpirun that this process starts and looks after."""

    def __init__(self, command: list[str]):
        handled = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
        signal.pthread_sigmask(signal.SIG_BLOCK, handled)  # which a child inherits
        self.requests = 0
        self.code: int | None = None
        self.stderr, end = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            become(command, end)
        os.close(end)
        for number in handled:
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # as nohup wants it
                signal.signal(number, self.handle_signal)
        for number in (signal.SIGUSR1, signal.SIGUSR2):
            signal.signal(number, lambda number, _: self.send(number))
        signal.pthread_sigmask(signal.SIG_UNBLOCK, handled)

    def send(self, number: int) -> None:
        """Send a signal to mpirun, if it has not ended."""
        if self.code is None:
            os.kill(self.pid, number)

    def handle_signal(self, *_: object) -> None:
        """The handler of a user's signals: the first one is passed on to mpirun as SIGUSR1, the third one kills it."""
        self.requests += 1
        if self.requests == 2:
            say(b"\nmpirun: the ranks have been told to stop; Ctrl-C once more kills them\n")
        else:
            self.send(signal.SIGUSR1 if self.requests == 1 else signal.SIGKILL)

    def look(self, how: int = 0) -> None:
        """Look whether it has ended, with how = 0 wait until it has: then `code` is its exit code, or minus a signal."""
        pid, status = os.waitpid(self.pid, how)
        if pid:
            self.code = os.waitstatus_to_exitcode(status)

    def relay(self) -> int:
        """Pass on what it prints on stderr until it ends; its exit code, or minus the signal that ended it."""
        passing, open_ = Filter(self.pid), True
        alone = -PATIENCE  # seconds for which it has been silent, and without ranks, after it said how it ends
        while open_:
            ready, _, _ = select.select([self.stderr], [], [], PATIENCE if self.code is None else 0.0)
            data = os.read(self.stderr, 65536) if ready else b""
            say(passing.feed(data) if data else passing.rest())
            waits = passing.code is not None and not ready and not has_children(self.pid)
            alone = alone + PATIENCE if waits else -PATIENCE
            if alone >= STUCK:
                self.send(signal.SIGKILL)
            if not (ready or self.code is not None):
                self.look(os.WNOHANG)  # others may keep stderr open when this one has ended; what it has said by then is read
            else:
                open_ = bool(data)
        while self.code is None:
            self.look()
        if self.requests and self.code in (-signal.SIGUSR1, 128 + signal.SIGUSR1, -signal.SIGKILL):
            return EXIT_ON_SIGNAL
        return self.code if self.code >= 0 or passing.code is None else passing.code


def has_children(pid: int) -> bool:
    """Has a process started others that have not ended? True where that is not known; Linux tells it."""
    found = []
    with suppress(OSError):
        for task in os.listdir(f"/proc/{pid}/task"):
            with open(f"/proc/{pid}/task/{task}/children", "rb") as children:
                found.append(children.read())
    return not found or any(map(runs, b" ".join(found).decode().split()))


def runs(pid: str) -> bool:
    """Has this process not ended yet? One that has, and that its parent has not asked for, is there as a zombie."""
    with suppress(OSError), open(f"/proc/{pid}/stat", "rb") as about:
        return about.read().rpartition(b") ")[2][:1] not in (b"Z", b"X")
    return False


def say(text: bytes) -> None:
    """Print on stderr; errors are ignored, for a run goes on when its terminal, or what reads its output, is gone."""
    with suppress(OSError):
        while text:
            text = text[os.write(2, text) :]


def become(command: list[str], stderr: int) -> NoReturn:
    """Become mpirun, which is killed when the process that started it is (on Linux)."""
    said = os.dup(2)  # not inherited by what is executed
    os.dup2(stderr, 2)
    try:
        if sys.platform == "linux":
            CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        os.execv(command[0], command)
    except OSError as error:
        os.write(said, f"{command[0]}: {error.strerror}\n".encode())
    os._exit(1)


def main() -> None:
    """Start mpirun, and end as it does."""
    code = Launcher(sys.argv[1:]).relay()
    if code < 0:
        with suppress(OSError):  # a program cannot say what SIGKILL does
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    sys.exit(code)


if __name__ == "__main__":
    main()
