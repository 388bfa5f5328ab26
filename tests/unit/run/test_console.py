"""What is printed: plain or for a terminal, folded or whole, and how far long work is."""

import re
import sys
from io import StringIO

import pytest
from conftest import ROOT
from numba.core import event

from particles_mpi import Scene, cli
from particles_mpi.run import console
from particles_mpi.run.console import Screen, announce_compiling

LINE = "  step: the fastest particle crosses 0.047 of the smallest diameter in a step (at most 1 is allowed)"


class Terminal(StringIO):
    """What is printed on a terminal of 40 columns."""

    def isatty(self):
        return True


def terminal(monkeypatch):
    """A terminal for this process, as mpirun gives one to its ranks, whether or not a user watches."""
    for name, value in {"TERM": "xterm", "COLUMNS": "40", "TTY_COMPATIBLE": "", "NO_COLOR": ""}.items():
        monkeypatch.setenv(name, value)
    for name in ("FORCE_COLOR", "GITHUB_ACTIONS", "PY_COLORS"):
        monkeypatch.delenv(name, raising=False)
    shown = Terminal()
    monkeypatch.setattr(sys, "stdout", shown)
    return shown


@pytest.mark.parametrize(("watched", "no_color", "plain"), [(True, "", False), (True, "1", True), (False, "", True)])
def test_help_is_plain_unless_a_terminal_shows_it(monkeypatch, watched, no_color, plain):
    shown = terminal(monkeypatch)
    monkeypatch.setattr(console, "watched", lambda: watched)
    monkeypatch.setenv("NO_COLOR", no_color)
    monkeypatch.setattr(sys, "argv", ["particles-mpi", "run", "--help"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    told = shown.getvalue()
    assert ended.value.code == 0 and "Usage:" in told and ("\x1b" not in told) == plain


@pytest.mark.parametrize("watched", [True, False])
def test_lines_are_folded_between_words_on_a_terminal_only(monkeypatch, watched):
    shown = terminal(monkeypatch)
    monkeypatch.setattr(console, "watched", lambda: watched)
    screen = Screen(is_root=True, quiet=False)
    screen.say(LINE)
    screen.say(LINE, whole=True)
    screen.say(" is bold", head="Only the head")
    *folded, whole, last = re.sub(r"\x1b\[\d*m", "|", shown.getvalue()).splitlines()
    assert whole == LINE and last == ("|Only the head| is bold" if watched else "Only the head is bold")
    assert " ".join(line.rstrip() for line in folded) == LINE
    assert max(map(len, folded)) <= 40 if watched else folded == [LINE]


def test_a_log_tells_now_and_then_how_far_tasks_are(monkeypatch, capsys):
    seconds = iter([0.0, 9.0, 11.0, 16.0, 17.0])
    monkeypatch.setattr(console, "watched", lambda: False)
    monkeypatch.setattr(console, "perf_counter", lambda: next(seconds))
    begin = Screen(is_root=True, quiet=False).count("errors", 4)
    for name in "abcd":
        begin(name)
    assert capsys.readouterr().out == "b: 1 of 4 done in 11 s\nd: 3 of 4 done in 17 s\n"


@pytest.mark.parametrize(
    ("d", "effects", "told"),
    [
        (3, {}, "kernels are compiled now, once"),
        (3, {"magnetic": {"file": "magnetic.py", "field": [0.0, 0.0, 1.0]}}, "kernels of magnetic.py are compiled now, once"),
        (4, {}, "dimension 4: kernels are compiled now, about 20 s, once"),
    ],
)
def test_what_is_compiled_is_told_once(d, effects, told, monkeypatch, capsys):
    listeners = []
    monkeypatch.setattr(event, "register", lambda _, listener: listeners.append(listener))
    tables = {"dimension": d, "time": {"step": 0.1, "steps": 1}, "particles": [{"position": [[0.0] * d]}], "effects": effects}
    announce_compiling(Scene.from_dict(tables, ROOT / "tests" / "parallel" / "outside"))
    for _ in range(2):
        listeners[0].on_start(None)
    assert capsys.readouterr().out == told + "\n"
