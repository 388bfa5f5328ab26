"""Stopped, killed, or out of disk: what was written stays, and a run that goes on has the bits of one that never stopped."""

import contextlib
import fcntl
import json
import os
import pty
import random
import shutil
import signal
import subprocess
import sys
import termios
import time
from pathlib import Path

import h5py
import killing
import pytest
from conftest import ROOT, run_ranks
from killing import contents, final_state, kill_and_resume, ranks_of, start
from with_all import with_all

pytestmark = pytest.mark.parallel
SLOW = killing.SCENE.replace("steps = 400", "steps = 100000000")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """(scene, folder of its uninterrupted run)."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "scene.toml").write_text(killing.SCENE)
    launcher = start(1, "run", folder / "scene.toml", "--output", folder / "run", "--quiet")
    told = killing.finish(launcher)
    assert launcher.returncode == 0, told
    return folder / "scene.toml", folder / "run"


def particles_mpi(ranks, *arguments):
    return run_ranks(ranks, "-m", "particles_mpi", *arguments)


def everything(folder):
    """Every byte below a folder."""
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.mark.parametrize("ranks", [2, *with_all(1, 3)])
def test_a_resumed_pile_goes_on_with_the_same_bits(ranks, tmp_path):
    """What contacts took is in the checkpoint: some rows for each sphere, so that their ids repeat."""
    done = run_ranks(ranks, "tests/parallel/resumed_piles.py", tmp_path)
    assert "the same bits" in done.stdout, done.stderr


@pytest.mark.parametrize("kills", [2, *with_all(10)])
def test_killed_again_and_again_the_run_has_the_same_bits(whole, tmp_path, kills):
    scene, run = whole
    kill_and_resume(tmp_path / "o", scene, contents(run), kills, random.Random(os.urandom(8)))
    assert contents(tmp_path / "o") == contents(run) and final_state(tmp_path / "o") == final_state(run)
    assert not list((tmp_path / "o").rglob("*.tmp"))


def scenes():
    """Every effect, integrator and operator; those whose state is more than positions and velocities above all."""
    box = {"lower": [0, 0], "upper": [4, 4]}
    gas = {"count": 30, "position": "random", "velocity": {"speed": 2.0}, "radius": 0.1, "mass": {"min": 0.1, "max": 0.5}}
    output = {"every": 4, "checkpoint_every": 7, "diagnostics_every": 3, "observables": True}
    down, pull = {"acceleration": [0, -9.81]}, {"G": 0.1, "softening": 0.1}
    pushed = {**gas, "acceleration": [0.5, 0], "drag": 0.3}
    full = {"walls": {"restitution": 0.9}, "uniform_gravity": down, "drag": {}, "user_acceleration": {}, "mutual_gravity": pull}
    row = [[0.5 + 0.21 * k, 0.5] for k in range(8)]
    base = {"dimension": 2, "seed": 3, "box": box, "time": {"step": 0.01, "steps": 24}, "output": output}
    still = {"position": [[1.0, 0.1 + 0.2 * k] for k in range(8)], "radius": 0.1, "velocity": [0, -0.01]}
    surface = {"restitution": 0.5, "friction": 0.4}
    cloud = {"count": 20, "position": {"plummer": 1.0}, "velocity": "equilibrium", "mass": 0.02}
    open_ = {k: v for k, v in base.items() if k != "box"} | {"dimension": 3, "particles": [cloud]}
    return {
        "rewind": {**base, "particles": [pushed], "effects": {**full, "collisions": {"restitution": 0.8}}},
        "event": {
            **base,
            "particles": [pushed],
            "effects": {**full, "collisions": {"mode": "event", "restitution": 0.8}, "friction": {"strength": 0.01}},
        },
        "clocks": {  # inelastic collapse: the memory of the last contact decides
            **base,
            "particles": [
                {"position": row, "radius": 0.1},
                {"position": [[3.5, 0.5]], "radius": 0.1, "velocity": [-20, 0]},
                {"position": [[0.3, 2.5]], "radius": 0.2, "fixed": True},
            ],
            "effects": {"collisions": {"mode": "event", "restitution": 0.1, "contact_duration": 5e-3}, "walls": {}},
        },
        "resting": {
            **base,
            "particles": [still],
            "effects": {"collisions": {"restitution": 0.5}, "walls": {"restitution": 0.5}, "uniform_gravity": down},
        },
        "rough": {  # spins, and contacts that last
            **base,
            "particles": [{**still, "spin": 2.0}, {**gas, "spin": {"temperature": 0.01}}],
            "effects": {"collisions": surface, "walls": surface, "uniform_gravity": down, "rolling": {"resistance": 0.01}},
        },
        "periodic": {**base, "box": {**box, "periodic": True}, "particles": [gas], "effects": {"collisions": {"damping": 0.1}}},
        "taylor": {**base, "time": {"step": 0.01, "steps": 24, "integrator": "taylor"}, "particles": [pushed], "effects": full},
        "tree": {**open_, "effects": {"mutual_gravity": {**pull, "method": "tree"}}},
        "order4": {**open_, "time": {"step": 0.01, "steps": 12, "integrator": "order4"}, "effects": {"mutual_gravity": pull}},
        "adaptive": {**open_, "time": {"step": 0.02, "steps": 12, "integrator": "adaptive"}, "effects": {"mutual_gravity": pull}},
    }


def test_resume_on_other_ranks_has_the_same_bits_for_every_effect(tmp_path):
    (tmp_path / "scenes.json").write_text(json.dumps(scenes()))
    script = "tests/parallel/stop_and_go.py", tmp_path / "scenes.json"
    for ranks, *how in ((2, "whole"), (3, "parts", 9), (1, "parts", "resume")):
        done = run_ranks(ranks, *script, tmp_path / how[0], *how[1:], timeout=200)
        assert done.returncode == 0, done.stderr[-2000:]
    for name in scenes():
        a, b = contents(tmp_path / "whole" / name), contents(tmp_path / "parts" / name)
        assert a == b and len(a["frames"]) > 3, name
        assert final_state(tmp_path / "whole" / name) == final_state(tmp_path / "parts" / name), name


@pytest.mark.parametrize(
    ("number", "to", "after"),
    [
        (signal.SIGTERM, "rank", "checkpoint.h5"),
        (signal.SIGINT, "mpirun", "checkpoint.h5"),
        (signal.SIGTERM, "mpirun", "set-up"),
        (signal.SIGINT, "rank", "set-up"),
    ],
)
def test_a_signal_at_any_time_leaves_a_checkpoint_or_nothing(tmp_path, number, to, after):
    scene, out = tmp_path / "scene.toml", tmp_path / "o"
    scene.write_text(SLOW)
    launcher = start(2, "run", scene, "--output", out)
    while len(ranks_of(launcher)) < 2 or (after != "set-up" and not (out / after).exists()):
        assert launcher.poll() is None
        time.sleep(0.01)
    while not all("mpi4py" in Path(f"/proc/{rank}/maps").read_text() for rank in ranks_of(launcher)):
        time.sleep(0.01)  # it catches signals before it loads that
    time.sleep(random.uniform(0.0, 0.7))
    launcher.send_signal(number) if to == "mpirun" else os.kill(ranks_of(launcher)[1], number)
    told = killing.finish(launcher)
    assert "Traceback" not in told
    assert launcher.returncode == 130, told
    if after != "set-up":
        assert "continue with --resume" in told
    if not out.exists():
        return
    killed = to == "mpirun" and after == "set-up"  # a rank that ends in its set-up has the others killed: the next run tidies up
    assert killed or not list(out.rglob("*.tmp"))
    known = out / "checkpoint.h5"
    assert known.exists() or killed
    done = particles_mpi(1, "run", scene, "--output", out, "--resume", known if known.exists() else "auto", "--wall-time", "0")
    assert done.returncode == 130, done.stderr
    assert not list(out.rglob("*.tmp"))


@pytest.mark.parametrize("presses", [1, 2])
def test_ctrl_c_in_a_terminal_saves_at_once_and_twice_too(tmp_path, presses):
    """A terminal tells all processes of the command; Open MPI's mpirun, left alone, waits for seconds, or kills."""
    scene, out = tmp_path / "scene.toml", tmp_path / "o"
    scene.write_text(SLOW.replace("checkpoint_every = 3", "checkpoint_every = 1000"))  # one is saved: a disk may be slow
    command = ["mpirun", "-n", "2", sys.executable, "-m", "particles_mpi", "run", str(scene), "--output", str(out), "--quiet"]
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(ROOT)
        os.execvpe(command[0], command, killing.environment())
    rows = out / "diagnostics.csv"
    while not rows.exists() or rows.read_text().count("\n") < 3:  # of names, of the start, of a step
        time.sleep(0.01)
    pressed = time.monotonic()
    for _ in range(presses):
        os.write(terminal, b"\x03")
        time.sleep(0.01)
    said = b""
    with contextlib.suppress(OSError):  # Linux: nobody has the terminal open any more
        while part := os.read(terminal, 65536):
            said += part
    took = time.monotonic() - pressed
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 130, said
    assert b"continue with --resume" in said and took < 2.5, said  # 0.2 s where nothing else runs
    assert not list(out.rglob("*.tmp")) and final_state(out)[2] > 0


TALKING = """
import sys, time
from pathlib import Path
from mpi4py import MPI
for number in range(20):
    print("a line", file=sys.stderr, flush=True)
    time.sleep(0.05)
Path(sys.argv[1], str(MPI.COMM_WORLD.rank)).touch()
"""


@pytest.mark.parametrize("where", ["pipe", "terminal"])
def test_ranks_go_on_when_nobody_reads_what_they_print(tmp_path, where):
    """A pipe that is closed, and a terminal, under nohup: its end is a hangup."""
    script, done = tmp_path / "talking.py", tmp_path / "done"
    script.write_text(TALKING)
    done.mkdir()
    reading, writing = os.pipe() if where == "pipe" else pty.openpty()
    pid = os.fork()
    if pid == 0:
        os.setsid()
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        if where == "terminal":
            fcntl.ioctl(writing, termios.TIOCSCTTY, 0)
        os.dup2(writing, 2)
        os.closerange(3, 64)
        os.execvpe("mpirun", ["mpirun", "-n", "2", sys.executable, str(script), str(done)], killing.environment())
    os.close(writing)
    assert b"a line" in os.read(reading, 100)
    os.close(reading)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    assert sorted(path.name for path in done.iterdir()) == ["0", "1"]


STUBBORN = """
import signal, time
from mpi4py import MPI
for number in (signal.SIGUSR1, signal.SIGTERM, signal.SIGINT):
    signal.signal(number, signal.SIG_IGN)
MPI.COMM_WORLD.Barrier()
if MPI.COMM_WORLD.rank == 0:
    print("here", flush=True)
time.sleep(300)
"""


@pytest.mark.parametrize("numbers", [[signal.SIGINT] * 3, [signal.SIGKILL]])
def test_ranks_that_hear_nothing_end_at_the_third_time(tmp_path, numbers):
    """And when the process that looks after mpirun is killed."""
    script, pipe = tmp_path / "stubborn.py", subprocess.PIPE
    script.write_text(STUBBORN)
    command = ["mpirun", "-n", "2", sys.executable, str(script)]
    launcher = subprocess.Popen(command, env=killing.environment(), stdout=pipe, stderr=pipe, text=True)
    assert launcher.stdout.readline() == "here\n"
    ranks = ranks_of(launcher)
    for number in numbers:
        launcher.send_signal(number)
        time.sleep(0.6)
    told = killing.finish(launcher)
    assert launcher.returncode == (130 if len(numbers) > 1 else -9) and len(ranks) == 2
    assert ("Ctrl-C once more kills them" in told) == (len(numbers) > 1)
    end = time.monotonic() + 20
    while any(Path(f"/proc/{rank}").exists() for rank in ranks):
        assert time.monotonic() < end
        time.sleep(0.05)


def test_a_folder_has_one_run_at_a_time(tmp_path):
    """A second one writes nothing, and the first one goes on; when it has ended, the folder is free."""
    scene, out = tmp_path / "scene.toml", tmp_path / "o"
    scene.write_text(SLOW)
    launcher = start(2, "run", scene, "--output", out)
    while not (out / "checkpoint.h5").exists():
        assert launcher.poll() is None
        time.sleep(0.01)
    for way in (["--resume", "auto"], ["--resume", "auto", "--steps", "1"], ["--overwrite"]):
        done = particles_mpi(2, "run", scene, "--output", out, *way)
        assert (done.returncode, done.stderr) == (2, f"particles-mpi: --output: another run is writing into {out}\n")
    assert launcher.poll() is None
    launcher.terminate()
    killing.finish(launcher)
    done = particles_mpi(2, "run", scene, "--output", out, "--resume", "auto", "--wall-time", "0")
    assert done.returncode == 130 and "saved" in done.stderr


def test_a_run_goes_on_in_its_own_folder_only(whole, tmp_path):
    scene, run = whole
    other, out = tmp_path / "other.toml", tmp_path / "o"
    other.write_text(killing.SCENE.replace("seed = 5", "seed = 6"))
    assert particles_mpi(1, "run", other, "--output", out, "--steps", 20, "--quiet").returncode == 0
    before = everything(out)
    done = particles_mpi(2, "run", scene, "--resume", run / "checkpoint.h5", "--output", out, "--overwrite", "--steps", 400)
    assert done.returncode == 0 and (out / "checkpoint.h5").exists()  # asked for
    for path in everything(out).keys() - before.keys():
        path.unlink()
    for path, text in before.items():
        path.write_bytes(text)
    done = particles_mpi(2, "run", scene, "--resume", run / "checkpoint.h5", "--output", out)
    assert done.returncode == 2 and "holds a run other than the one" in done.stderr and everything(out) == before, done.stderr
    other.write_text(killing.SCENE.replace("restitution = 0.9", "restitution = 0.8"))
    done = particles_mpi(2, "run", other, "--resume", run / "checkpoint.h5", "--output", tmp_path / "new")
    assert done.returncode == 2 and not (tmp_path / "new").exists()
    assert "effects.collisions.restitution: differs from" in done.stderr and "effects.walls.restitution" in done.stderr


def test_a_later_end_is_gone_on_to(whole, tmp_path):
    scene, _ = whole
    short, out = tmp_path / "scene.toml", tmp_path / "o"
    short.write_text(killing.SCENE.replace("steps = 400", "steps = 30"))
    assert particles_mpi(2, "run", short, "--output", out, "--quiet").returncode == 0
    assert particles_mpi(1, "run", scene, "--output", out, "--resume", out / "checkpoint.h5", "--quiet").returncode == 0
    assert contents(out) == contents(whole[1]) and final_state(out) == final_state(whole[1])


def test_full_disk_leaves_a_checkpoint_to_go_on_from(whole, tmp_path):
    scene, run = whole
    out = tmp_path / "o"
    command = [sys.executable, "-m", "particles_mpi", "run", str(scene), "--output", str(out), "--quiet"]
    limited = ["mpirun", "-n", "2", "sh", "-c", 'ulimit -f 800; exec "$@"', "sh", *command]
    done = subprocess.run(limited, cwd=ROOT, env=killing.environment(), capture_output=True, text=True, timeout=100)
    assert done.returncode == 3 and "Traceback" not in done.stderr, done.stderr
    assert f"cannot write {out}" in done.stderr and "File too large" in done.stderr and "at step" in done.stderr
    assert killing.check_killed(out, contents(run)) > 100
    done = particles_mpi(1, "run", scene, "--output", out, "--resume", out / "checkpoint.h5", "--quiet")
    assert done.returncode == 0, done.stderr
    assert contents(out) == contents(run) and final_state(out) == final_state(run)


@pytest.mark.slow
@pytest.mark.parametrize("kilobytes", [60, 120, 200, 400])
def test_a_disk_that_is_full_from_the_first_frame_on_is_one_line(whole, tmp_path, kilobytes):
    """A rank that fails in parallel HDF5 leaves others waiting there; and HDF5 crashes when it closes what it cannot write."""
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "none", tmp_path], capture_output=True)
    if made.returncode:
        pytest.skip("no disk can be mounted here")
    try:
        scene = tmp_path.parent / "full.toml"
        scene.write_text(killing.SCENE.replace("steps = 400", "steps = 4000"))
        for ranks in (1, 2):
            done = particles_mpi(ranks, "run", scene, "--output", tmp_path / f"o{ranks}", "--quiet")
            assert done.returncode == 3 and "cannot " in done.stderr and "Traceback" not in done.stderr, done.stderr
            shutil.rmtree(tmp_path / f"o{ranks}")
    finally:
        subprocess.run(["umount", "-l", tmp_path], check=True)


@pytest.mark.parametrize("below", ["file", "proc", "long"])
def test_a_folder_that_cannot_be_written_is_one_line(whole, tmp_path, below):
    (tmp_path / "file").write_text("text")
    folder = {"file": tmp_path / "file" / "o", "proc": Path("/proc/self/o"), "long": tmp_path / ("x" * 300)}[below]
    done = particles_mpi(2, "run", whole[0], "--output", folder, "--quiet")
    code, what = (3, folder) if below == "proc" else (2, "--output: ")  # 2: what no folder can be is a wrong argument
    assert done.returncode == code and str(what) in done.stderr and "Traceback" not in done.stderr, done.stderr


@pytest.mark.parametrize(
    ("fault", "mode", "says"),
    [
        ("raise", "rewind", "ZeroDivisionError"),
        ("nan", "rewind", "on rank 1 has a position or velocity that is not finite"),
        ("nan", "event", "has a position or velocity that is not finite"),
        ("given", "rewind", "on rank 1 was given nan, nan, which is not possible"),
        ("given", "event", "on rank 1 was given nan, nan, which is not possible"),
    ],
)
def test_what_goes_wrong_on_one_rank_ends_all(tmp_path, fault, mode, says):
    done = run_ranks(2, "tests/parallel/one_rank_fails.py", tmp_path / "o", fault, mode, fresh=fault == "raise")
    assert done.returncode == 3 and says in done.stderr, done.stderr
    assert killing.check_killed(tmp_path / "o", contents(tmp_path / "o")) == 9


def test_damaged_files_are_refused_before_anything_is_touched(whole, tmp_path):
    scene, run = whole
    out = tmp_path / "o"
    shutil.copytree(run, out)
    for name, damage, says in (
        ("checkpoint.h5", lambda old: old[: len(old) // 2], "cut short"),
        ("trajectory.vtkhdf", lambda old: old[: len(old) // 2], "cannot be continued"),
        ("diagnostics.csv", lambda old: old[: len(old) // 2], "it should end with step 400"),
    ):
        old = (out / name).read_bytes()
        (out / name).write_bytes(damage(old))
        before = everything(out)
        done = particles_mpi(2, "run", scene, "--output", out, "--resume", out / "checkpoint.h5")
        assert done.returncode == 2 and f"{out / name}: " in done.stderr and says in done.stderr, done.stderr
        assert len([line for line in done.stderr.splitlines() if line.startswith("particles-mpi")]) == 1
        assert everything(out) == before
        (out / name).write_bytes(old)


def test_a_file_that_was_deleted_is_told_of(tmp_path):
    scene, out = tmp_path / "scene.toml", tmp_path / "o"
    scene.write_text(killing.SCENE)
    assert particles_mpi(2, "run", scene, "--output", out, "--steps", 12, "--quiet").returncode == 0
    for step, names in ((16, ["trajectory.vtkhdf"]), (20, ["particles.pvd", "diagnostics.csv"]), (24, [])):
        for name in names:
            (out / name).unlink()
        done = particles_mpi(2, "run", scene, "--output", out, "--resume", "auto", "--steps", step)
        told = [line.split(f"{out}/")[1] for line in done.stdout.splitlines() if line.startswith("  warning:")]
        assert done.returncode == 0 and told == [f"{n} is missing: a new one begins after step {step - 4}" for n in names]
    frame = "vtk/particles_000022.vtu"
    (out / frame).unlink()
    done = particles_mpi(1, "run", scene, "--output", out, "--resume", "auto", "--steps", 28)
    assert done.returncode == 0 and f"{out / frame} is missing: particles.pvd no longer lists it" in done.stdout
    listed = (out / "particles.pvd").read_text()
    assert frame not in listed and "000024.vtu" in listed and "000028.vtu" in listed


LIMITED = """
dimension = 2
time = {step = 0.001, steps = 300}
particles = [{count = 2000, position = "random", velocity = {speed = 1}}]
effects = {walls = {}}
output = {every = 5, formats = ["hdf5"], checkpoint_every = 50}
[box]
lower = [0, 0]
upper = [9, 9]
"""


@pytest.mark.parametrize("limit", [5_500_000, *with_all(4_608_000, 7_000_000)])
def test_one_rank_may_write_files_of_a_limited_size(tmp_path, limit):
    """What is shown by then can be read, and the run goes on where there is no limit."""
    (tmp_path / "a.toml").write_text(LIMITED)
    command = [sys.executable, "-m", "particles_mpi", "run", "a.toml", "--output", "out", "--quiet"]
    limited = ["bash", "-c", f"ulimit -f {limit // 1024}; exec {' '.join(command)}"]
    stopped = subprocess.run(limited, cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert stopped.returncode == 3 and "File too large" in stopped.stderr and stopped.stderr.count("\n") == 1, stopped.stderr
    with h5py.File(tmp_path / "out/trajectory.vtkhdf") as file, h5py.File(tmp_path / "out/checkpoint.h5") as saved:
        assert file["VTKHDF/Steps"].attrs["NSteps"] >= saved.attrs["step"] // 5 + 1
    again = subprocess.run([*command, "--resume", "auto"], cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert again.returncode == 0, again.stderr
