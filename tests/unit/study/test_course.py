"""The course page: what it tells to type exists, and its program prints the figures that it promises."""

import re
import shlex

import numpy as np
import pytest
from conftest import ROOT
from typer.testing import CliRunner

from particles_mpi.cli import app

PAGE = (ROOT / "particles_mpi" / "study" / "course.md").read_text()
COMMANDS = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.S) for line in block.splitlines()]


def test_six_exercises_each_with_a_figure_to_expect():
    assert len(re.findall(r"^## \d\.", PAGE, re.M)) == 6 == len(re.findall(r"^Expect", PAGE, re.M))


@pytest.mark.parametrize("command", [c for c in COMMANDS if "./run.sh" in c and "run.sh test" not in c])
def test_commands_exist(command):
    """The words before the options are commands, the options are theirs, the scenes are there."""
    words = [w for w in shlex.split(command) if "=" not in w][1:]
    scenes = [w for w in words if w.endswith(".toml") and not w.startswith("out/")]
    assert all((ROOT / scene).exists() for scene in scenes)
    names = words[: 2 if words[0] == "study" else 1]
    told = CliRunner().invoke(app, [*names, "--help"], env={"COLUMNS": "200", "NO_COLOR": "1"})
    assert told.exit_code == 0
    assert all(option in told.output for option in words if option.startswith("--"))


def test_the_program_prints_what_it_should(capsys):
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    exec(program, {})
    for mode, line in zip(("rewind", "event"), capsys.readouterr().out.splitlines(), strict=True):
        name, velocity = line.split(" ", 1)
        assert name == mode
        np.testing.assert_allclose(np.fromstring(velocity.strip("[]"), sep=" "), (0.25, 0.4330127), atol=1e-7)
