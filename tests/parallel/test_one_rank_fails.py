"""A fault on one rank ends all of them: within ten seconds, with the exit code of the fault and one line that names the rank."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import h5py
import pytest
from conftest import ROOT, run_ranks
from ranks import environment

from particles_mpi.integrators.kicks_and_drifts import Composition
from particles_mpi.neighbours.neighbour_list import Neighbourhood
from particles_mpi.output import checkpoint
from particles_mpi.output.trajectory import Trajectory
from particles_mpi.parallel import launcher
from particles_mpi.parallel.agreement import wait_until_read
from particles_mpi.parallel.communicator import mpi_library
from particles_mpi.parallel.launcher import Filter

pytestmark = pytest.mark.parallel

SCENE = """
dimension = 2
seed = 5
box = {lower = [0, 0], upper = [4, 4]}
time = {step = 0.01, steps = 40}
particles = [{count = 40, position = "random", velocity = {speed = 2.0}, radius = 0.1}]
effects = {collisions = {}, walls = {}}
output = {every = 1, checkpoint_every = 5, diagnostics_every = 1}
"""
WITHIN = 10.0  # seconds from the fault to the end of mpirun
DIVISION = "unexpected ZeroDivisionError: division by zero (at "
ADVANCE, WRITE = f"{Composition.__module__}:Composition.advance", f"{Trajectory.__module__}:Trajectory.write"


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


def start(*programs):
    """One rank of each of the programs (words after `python`); (exit code, stderr)."""
    words = ["mpirun"]
    for program in programs:
        words += [":", "-n", "1", sys.executable, *map(str, program)]
    words.pop(1)
    done = subprocess.run(words, cwd=ROOT, env=environment(), capture_output=True, text=True, timeout=100)
    return done.returncode, done.stderr


def with_fault(folder, fault, rank, *arguments):
    """(exit code, stderr, seconds since the fault) of the program on two ranks."""
    stamp = folder / "stamp"
    program = ["tests/parallel/faulty.py", fault, rank, stamp, *arguments]
    done = run_ranks(2, *program, timeout=100, fresh=True)
    return done.returncode, done.stderr, time.time() - stamp.stat().st_mtime if stamp.exists() else 0.0


def test_what_goes_wrong_in_the_set_up_of_one_rank_is_raised_on_all(tmp_path):
    done = run_ranks(2, "tests/parallel/agreeing.py", tmp_path)
    assert done.returncode == 0, done.stderr
    told, other = json.loads(done.stdout)
    assert {what: fault[:2] for what, fault in told.items()} == {what: fault[:2] for what, fault in other.items()}
    expected = {
        "scene": ("SceneError", "rank 1: ", "1/scene.toml: cannot be read (No such file"),
        "scene on rank 0": ("SceneError", "rank 0: ", "1/scene.toml: cannot be read (No such file"),
        "file": ("SceneError", "particles[0].position: rank 1: ", "1/none.csv cannot be read (No such file"),
        "rows": ("SceneError", "rank 0: particles[0].position: ", "rows.csv: not the same on rank 1 as on rank 0"),
        "checkpoint": ("SceneError", "rank 1: ", "1/checkpoint.h5: no such checkpoint"),
        "damaged": ("SceneError", "rank 0: ", "0/damaged.h5: damaged"),
        "json": ("SceneError", "rank 1: ", "1/state.json: no such file"),
        "another json": ("SceneError", "rank 1: ", "step: 3, but 4 on rank 0"),
        "scenes": ("SceneError", "rank 1: ", "time.steps: 5, but 4 on rank 0"),
        "option": ("SceneError", "rank 1: ", "--steps: 3, but 2 on rank 0"),
        "memory": ("SceneError", "rank 1: ", "not enough memory"),
        "populate": ("StoppedError", "rank 1: ", DIVISION),
        "assemble": ("StoppedError", "rank 1: ", DIVISION),
    }
    assert told.keys() == expected.keys()
    for what, (kind, begin, says) in expected.items():
        found, text, seconds = told[what]
        assert found == kind and text.startswith(begin) and says in text and "\n" not in text and seconds < WITHIN, text
    assert not (tmp_path / "new").exists()


def test_a_scene_that_is_missing_on_one_rank(scene, tmp_path):
    out, none = tmp_path / "o", tmp_path / "none.toml"
    code, said = start(*(["-m", "particles_mpi", "run", one, "--output", out] for one in (scene, none)))
    assert (code, said) == (2, f"particles-mpi: rank 1: {none}: cannot be read (No such file or directory)\n")
    assert not out.exists()


APART = """
import os, sys
folder, *program = sys.argv[1:]
hide = 'mount -t tmpfs none "$0" && exec "$@"'
os.execvp("unshare", ["unshare", "-m", "sh", "-c", hide, folder, sys.executable, *program])
"""


@pytest.mark.skipif(subprocess.run("unshare -m true", shell=True, capture_output=True).returncode, reason="not for any user")
@pytest.mark.parametrize("formats", ["hdf5", "vtk"])
def test_a_folder_that_machines_do_not_share(scene, tmp_path, formats):
    """Rank 1 has a file system of its own in its place: MPI would wait inside of the call that opens a file."""
    out = tmp_path / "out"
    out.mkdir()
    scene.write_text(SCENE.replace("every = 1, c", f'formats = ["{formats}"], every = 1, c'))
    program = ["-m", "particles_mpi", "run", scene, "--output", out / "o", "--quiet"]
    code, said = start(program, ["-c", APART, out, *program])
    assert code == 3 and said.count("\n") == 1, said
    assert said.startswith(f"particles-mpi: rank 1: cannot {'open' if formats == 'hdf5' else 'write'} {out}/o/"), said
    assert said.endswith(": this rank does not find it: all machines must share the folder\n"), said


def test_arguments_that_differ(scene, tmp_path):
    program = ["-m", "particles_mpi", "run", scene, "--output", tmp_path / "o"]
    code, said = start([*program, "--quiet"], [*program, "--help"])
    assert code == 2 and said.startswith("particles-mpi: rank 1: arguments: ") and said.count("\n") == 1, said
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(
    ("fault", "rank", "says"),
    [
        (f"{Neighbourhood.__module__}:Neighbourhood.__init__", 1, "simulation.py"),  # others wait for it inside the set-up
        (ADVANCE, 0, "simulation.py"),
        (ADVANCE, "all", "simulation.py"),
        (WRITE, 1, "job.py"),
        (f"{checkpoint.__name__}:_replace", 0, "checkpoint.py"),
    ],
)
def test_an_exception_in_any_phase_of_one_rank(scene, tmp_path, fault, rank, says):
    code, said, seconds = with_fault(tmp_path, fault, rank, "run", scene, "--output", tmp_path / "o", "--quiet")
    assert code == 3 and said.count("\n") == 1 and DIVISION in said and says in said and seconds < WITHIN, said
    assert said.startswith("particles-mpi: " if rank == "all" else f"particles-mpi: rank {rank}: "), said
    assert not list(tmp_path.rglob("*.tmp"))


@pytest.mark.parametrize(("fault", "rank"), [(f"{Neighbourhood.__module__}:Neighbourhood.__init__", 1), (ADVANCE, 0), (WRITE, 1)])
def test_a_rank_that_leaves_ends_all_others(scene, tmp_path, fault, rank):
    """By sys.exit it would wait for the others, and they for it."""
    code, said, seconds = with_fault(tmp_path, f"leaves:{fault}", rank, "run", scene, "--output", tmp_path / "o", "--quiet")
    assert code == 3 and said.count("\n") == 1 and seconds < WITHIN, said
    assert said.startswith(f"particles-mpi: rank {rank}: unexpected SystemExit: table.dat: not found (at ")


OPEN_MPI = pytest.mark.skipif(not mpi_library().startswith("Open MPI"), reason="other launchers have words of their own for it")


@OPEN_MPI
def test_a_rank_that_is_gone_without_a_word_is_named(scene, tmp_path):
    code, said, seconds = with_fault(tmp_path, f"quits:{ADVANCE}", 1, "run", scene, "--output", tmp_path / "o", "--quiet")
    assert (code, said) == (7, "mpirun: rank 1 ended with exit code 7\n") and seconds < WITHIN


THIEF = """
from particles_mpi.effects import EffectOptions, Event, Needs

class Options(EffectOptions):
    pass

class Effect(Event):
    formula = "7 is gone"
    needs = Needs(integrators=("leapfrog",))
    acts = 0

    def act(self, particles, h):
        self.acts += 1
        if self.acts > 12:
            particles.position[particles.id == 7] = 50.0
        return int((particles.id == 7).sum())
"""


@pytest.mark.parametrize("fault", [None, f"{checkpoint.__name__}:_replace"])
def test_a_state_without_a_meaning_is_kept_by_all_ranks(scene, tmp_path, fault):
    """Each writes its own rows, and holds no others; what has gone wrong is told even if that fails."""
    (tmp_path / "thief.py").write_text(THIEF)
    lines = SCENE.replace("walls = {}", 'walls = {}, thief = {file = "thief.py"}').replace("_every = 5", "_every = 1000")
    scene.write_text(lines)
    out = tmp_path / "o"
    arguments = ["run", scene, "--output", out, "--quiet"]
    done = run_ranks(2, "-m", "particles_mpi", *arguments) if not fault else None
    code, said, _ = with_fault(tmp_path, fault, 0, *arguments) if fault else (done.returncode, done.stderr, 0.0)
    assert code == 3 and said.count("\n") == 1 and re.search(r"particle 7 on rank . is beyond wall", said), said
    if fault:
        assert "cannot write" in said and "stopped.h5" in said and not (out / "stopped.h5").exists(), said
        return
    with h5py.File(out / "stopped.h5") as file:
        rows = {name: column[:] for name, column in file["particles"].items()}
    assert sorted(rows["id"]) == list(range(40)) and sorted(set(rows["rank"])) == [0, 1]
    assert (rows["position"][rows["id"] == 7] > 40.0).all() and (rows["position"][rows["id"] != 7] < 5.0).all()


def test_a_disk_that_is_full_on_one_rank(scene, tmp_path):
    out, rank = tmp_path / "o", int(h5py.get_config().mpi)  # without parallel HDF5 only rank 0 writes
    code, said, seconds = with_fault(tmp_path, "full disk", rank, "run", scene, "--output", out, "--quiet")
    assert code == 3 and said.count("\n") == 1 and seconds < WITHIN, said
    assert (
        said.startswith(f"particles-mpi: rank {rank}: cannot write {out}/trajectory.vtkhdf at step") and "File too large" in said
    )


@OPEN_MPI
def test_a_rank_that_is_killed_is_told_in_one_line(scene, tmp_path):
    code, said, seconds = with_fault(tmp_path, f"killed:{ADVANCE}", 1, "run", scene, "--output", tmp_path / "o", "--quiet")
    assert code == 137 and said.count("\n") == 1 and said.startswith("mpirun: rank 1 on ") and "signal 9" in said, said
    assert seconds < WITHIN


def test_a_rank_that_failed_waits_until_its_message_is_read():
    """Otherwise the launcher, on a machine with much to do, learns first that the rank has ended, and closes the pipe."""
    source, end = os.pipe()
    os.write(end, b"why")
    begin = time.monotonic()
    wait_until_read(end, 0.2)
    assert time.monotonic() - begin >= 0.2  # nobody reads it
    begin = time.monotonic()
    threading.Timer(0.2, os.read, (source, 10)).start()
    wait_until_read(end, 20.0)
    assert 0.1 < time.monotonic() - begin < 10.0
    wait_until_read(end, 20.0)  # nothing is left to read
    os.close(source)
    os.close(end)
    wait_until_read(end, 20.0)  # no such pipe
    with open(os.devnull, "w") as null:
        wait_until_read(null.fileno(), 20.0)
    assert time.monotonic() - begin < 20.0


STANDS_STILL = """
from particles_mpi import Scene, Simulation
from particles_mpi.contacts.event_driven.engine import Engine
from particles_mpi.errors import StateError
from particles_mpi.study.experiment import Benchmark
from particles_mpi.study.recommend import predict
costs, run, at = predict.costs_of, Engine.run, {"costs": False}

def counted(*arguments):
    at["costs"] = True
    return costs(*arguments)

def standing(engine, *arguments):
    if at["costs"] and sim.ranks.rank == 1:
        raise StateError("time stands still")
    return run(engine, *arguments)

predict.costs_of, Engine.run = counted, standing
discs = {"count": 20, "position": "random", "radius": 0.2, "velocity": {"speed": 1.0}}
box, effects = {"lower": [0, 0], "upper": [5, 5]}, {"collisions": {"mode": "event"}, "walls": {}}
sim = Simulation(Scene(dimension=2, time={"step": 0.01, "steps": 100}, box=box, particles=[discs], effects=effects))
predict.predict(sim, Benchmark())
"""


def test_what_check_and_study_get_over_ends_all_if_one_rank_alone_has_it(tmp_path):
    """A scene that cannot go on without some effect is left out; the others would wait for a rank that does so alone."""
    script = tmp_path / "check.py"
    script.write_text(STANDS_STILL)
    done = run_ranks(2, script, fresh=True)
    assert done.returncode == 3
    assert re.fullmatch(r"particles-mpi: rank 1: step \d+: time stands still\n", done.stderr), done.stderr


def test_a_script_that_nobody_catches_errors_in(tmp_path):
    """A SceneError of one rank is a line, and what nobody expected one traceback, of the lowest of the ranks that fail."""
    text = "import sys\nfrom particles_mpi import Scene, Simulation\nfrom mpi4py import MPI\n"
    one, both = tmp_path / "one.py", tmp_path / "both.py"
    one.write_text(text + "if MPI.COMM_WORLD.rank:\n    Scene.load('none.toml')\nMPI.COMM_WORLD.Barrier()\n")
    both.write_text(text + "1 / 0\n")
    done = run_ranks(2, one, fresh=True)
    assert done.returncode == 2
    assert done.stderr == "particles-mpi: rank 1: none.toml: cannot be read (No such file or directory)\n"
    done = run_ranks(2, both, fresh=True)
    assert done.returncode == 3 and done.stderr.count("Traceback") == 1
    assert done.stderr.endswith("ZeroDivisionError: division by zero\n")


@pytest.mark.parametrize(
    ("kind", "method"), [("Force", "add(self, p, a)"), ("VelocityFlow", "advance(self, p, h)"), ("Event", "act(self, p, h)")]
)
def test_an_effect_of_a_script_that_leaves_on_one_rank(tmp_path, kind, method):
    """In whichever way it acts, the other ranks do not wait for it."""
    (tmp_path / "leaving.py").write_text(
        f"import sys\nfrom mpi4py import MPI\nfrom particles_mpi.effects import EffectOptions, {kind}\n\n\n"
        f"class Options(EffectOptions):\n    pass\n\n\nclass Effect({kind}):\n    formula = 'none'\n\n"
        f"    def {method}:\n        if MPI.COMM_WORLD.rank:\n            sys.exit('gone')\n"
        f"        return {0 if kind == 'Event' else None}\n"
    )
    effects, pair = {"leaving": {"file": str(tmp_path / "leaving.py")}, "collisions": {}}, {"position": [[0.0], [1.0]]}
    tables = {"dimension": 1, "time": {"step": 0.1, "steps": 9}, "particles": [pair], "effects": effects}
    script = tmp_path / "script.py"
    script.write_text(f"from particles_mpi import Scene, Simulation\nSimulation(Scene.from_dict({tables})).run()\n")
    done = run_ranks(2, script, timeout=100, fresh=True)
    assert done.returncode == 3 and done.stderr.startswith("particles-mpi: rank 1: unexpected SystemExit: gone (at "), done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(("on_rank_0", "says"), [("sys.stderr = None", ""), ("sys.excepthook = lambda *error: None", "rank 1: ")])
def test_a_rank_that_cannot_tell_why_it_ends_is_not_waited_for(tmp_path, on_rank_0, says):
    """One that leaves without a word is where the others do not expect it: these would wait for it, and it for them."""
    script = tmp_path / "silent.py"
    lines = ["import sys", "from particles_mpi import Scene, Simulation", "from mpi4py import MPI", "MPI.COMM_WORLD.Barrier()"]
    script.write_text("\n".join([*lines, "if MPI.COMM_WORLD.rank == 0:", f"    {on_rank_0}", "Scene.load('none.toml')"]))
    done = run_ranks(2, script, timeout=100, fresh=True)
    assert done.returncode == 2
    assert done.stderr == (says and f"particles-mpi: {says}none.toml: cannot be read (No such file or directory)\n")


MUTE = """
import time
from types import SimpleNamespace
from mpi4py import MPI
from particles_mpi.parallel import agreement

class Mute:
    def __getattr__(self, name):
        return getattr(MPI.COMM_WORLD, name)
    def Abort(self, code):
        time.sleep(60)

agreement.ABORT_SECONDS = 1
agreement.MPI = SimpleNamespace(COMM_WORLD=Mute(), Status=MPI.Status)
if MPI.COMM_WORLD.rank:
    1 / 0
MPI.COMM_WORLD.Barrier()
"""


def test_a_launcher_that_never_answers_is_not_waited_for(tmp_path):
    script = tmp_path / "mute.py"
    script.write_text(MUTE)
    begin = time.monotonic()
    done = run_ranks(2, script, timeout=100, fresh=True)
    assert done.returncode == 128 + signal.SIGALRM and "ZeroDivisionError" in done.stderr
    assert time.monotonic() - begin < 2 * WITHIN


RULE = "-" * 74 + "\n"
EXITED = (
    f"{RULE}Primary job  terminated normally, but 1 process returned\na non-zero exit code. Per user-direction, the job has been"
    f" aborted.\n{RULE}{RULE}mpirun detected that one or more processes exited with non-zero status, thus causing\nthe job to be"
    f" terminated. The first process to do so was:\n\n  Process name: [[1,1],1]\n  Exit code:    2\n{RULE}"
)
GONE = EXITED.replace("2\n" + RULE, "7\n" + RULE)
ABORTED = (
    f"{RULE}MPI_ABORT was invoked on rank 1 in communicator MPI_COMM_WORLD\n  Proc: [[13718,1],1]\n  Errorcode: 3\n{RULE}"
    "[vm:7] 1 more process has sent help message help-mpi-api.txt / mpi-abort\n"
    '[vm:7] Set MCA parameter "orte_base_help_aggregate" to 0 to see all help / error messages\n'
)
FORWARDED = "mpirun.openmpi: Forwarding signal 10 to job\n"
EVENTS = "[warn] Epoll MOD(1) on fd 23 failed. Old events were 6; read change was 0 (none): Bad file descriptor\n"
KILLED = f"{RULE}prterun noticed that process rank 1 with PID 8 on node vm exited on\nsignal 9 (Killed).\n{RULE}"
MISSING = f"{RULE}mpirun was unable to find the specified executable file, and therefore\ndid not launch the job.\n{RULE}"
OWN = "a line\n---- not a rule\nprogress 10 %\r" + "-" * 74 + " nor this\n" + "-" * 80 + "\n"


@pytest.mark.parametrize("chunk", [1, 7, 74, 75, 10**6])
def test_the_paragraphs_of_the_launcher_are_left_out_and_nothing_else(chunk):
    said, passing = (
        (OWN + EXITED + EVENTS + FORWARDED + OWN + ABORTED + KILLED + GONE + MISSING + OWN + "no end").encode(),
        Filter(),
    )
    assert passing.code is None
    passed = b"".join(passing.feed(said[k : k + chunk]) for k in range(0, len(said), chunk)) + passing.rest()
    ended = "mpirun: rank 1 on vm was ended by signal 9 (Killed)\nmpirun: rank 1 ended with exit code 7\n"
    assert passed.decode() == f"{OWN}{OWN}{ended}{MISSING}{OWN}no end"
    assert passing.code == 2  # the first that was said


CRASH = "[vm:$$] *** Process received signal ***\n[vm:$$] Signal: Segmentation fault (11)\n[vm:$$] *** End of error message ***\n"
OTHER = "[vm:1] a line of a rank\n"


def launch(mpirun, lines):
    """(exit code, stderr) of the launcher with a shell script as mpirun, which it waits for 1.5 seconds instead of five."""
    mpirun.write_text(f"#!/bin/sh\n{lines}\n")
    mpirun.chmod(0o755)
    folder = str(Path(launcher.__file__).parent)
    sooner = "launcher.PATIENCE, launcher.STUCK = 0.25, 1.5"
    program = f"import sys; sys.path.append({folder!r}); import launcher; {sooner}; launcher.main()"
    done = subprocess.run([sys.executable, "-ISc", program, mpirun], capture_output=True, text=True, timeout=50)
    return done.returncode, done.stderr


FAULTS = [(EXITED, 2), (GONE, 7), (ABORTED, 3), (ABORTED.replace("  Errorcode: 3", "with errorcode 1."), 1), (KILLED, 137)]


@pytest.mark.parametrize(("paragraph", "code"), [*FAULTS, ("", -signal.SIGSEGV)])
def test_an_mpirun_that_crashes_when_all_ranks_have_ended(tmp_path, paragraph, code):
    """It ends as it has said that it would; what it says of its own crash is left out then, and only that."""
    found, said = launch(tmp_path / "mpirun", f"printf %s '{paragraph}' \"{CRASH}{OTHER}\" >&2; kill -SEGV $$")
    assert found == code and OTHER in said and ("Segmentation" in said) == (code < 0), said


def test_an_mpirun_that_is_killed_ends_the_launcher_alike(tmp_path):
    assert launch(tmp_path / "mpirun", "kill -KILL $$") == (-signal.SIGKILL, "")


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells whether a process has children")
@pytest.mark.parametrize(("paragraph", "code"), [(ABORTED, 3), (KILLED, 137)])
def test_an_mpirun_that_waits_for_itself_when_all_ranks_have_ended(tmp_path, paragraph, code):
    """A rank that has ended may still be there as a zombie: it has not been asked for."""
    assert launch(tmp_path / "mpirun", f"printf %s '{paragraph}' >&2; sleep 0.1 & exec sleep 40")[0] == code


@pytest.mark.parametrize(("paragraph", "ranks", "its_end"), [(ABORTED, 2.0, 0.35), ("", 0.0, 2.0)])
def test_an_mpirun_is_waited_for_while_it_has_ranks_or_has_not_said_how_it_ends(tmp_path, paragraph, ranks, its_end):
    """However long the ranks take: what counts is for how long there have been none."""
    end = f"exec {sys.executable} -ISc 'import time; time.sleep({its_end}); raise SystemExit(5)'"
    assert launch(tmp_path / "mpirun", f"printf %s '{paragraph}' >&2; sleep {ranks}; {end}") == (5, "")


def test_what_cannot_be_a_paragraph_passes_at_once():
    passing = Filter()
    for text in (b"par", b"t of a line", b"\n", b"--\n", b"-" * 75, b"\n", b"x"):
        assert passing.feed(text) == text
    assert passing.feed(b"\n---") == b"\n" and passing.feed(b"x") == b"---x"
